"""Ellipsoids that adapters of other engines store, beside the covariances that they are made of."""

import gzip
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsgen.contract.spec.srgb import srgb_of_linear
from gsgen.formats.shared.harmonics import sh_basis
from support.commands import ROOT
from support.web.packages import require_node
from support.web.pages import CLIENT

_ENGINES = CLIENT / "engines"
_SCRIPT = """
import { readFileSync } from "node:fs";
const { Ellipsoids } = await import(process.argv[2]);
const { format, frames } = JSON.parse(readFileSync("frames.json", "utf-8"));
const ellipsoids = new Ellipsoids(format);
const target = ellipsoids.target();
const arrays = new Map();
const float32 = (numbers) => {
  const key = JSON.stringify(numbers);
  if (!arrays.has(key)) arrays.set(key, Float32Array.from(numbers, (number) => number ?? NaN));
  return arrays.get(key);
};
const results = frames.map(({ rows, appearance, live, eye }) => {
  ellipsoids.write({ rows: float32(rows), appearance: float32(appearance), live }, target, eye);
  const numbers = Object.entries(target).map(([name, array]) => [name, [...array]]);
  return { ...Object.fromEntries(numbers), low: ellipsoids.low, high: ellipsoids.high };
});
console.log(JSON.stringify({ results, needsCamera: ellipsoids.needsCamera }));
"""
_IDENTITY = np.eye(4)


def written(folder: Path, format: dict[str, Any], frames: list[dict[str, Any]]) -> Any:
    """Return what the module writes for frames, one after the other into the same arrays."""
    for frame in frames:
        for name in ("rows", "appearance"):
            numbers = np.float64(frame[name]).ravel()
            frame[name] = [float(x) if np.isfinite(x) else None for x in numbers]
    words = {"format": {"transform": _IDENTITY.ravel().tolist()} | format, "frames": frames}
    (folder / "frames.json").write_text(json.dumps(words), "utf-8")
    (folder / "run.mjs").write_text(_SCRIPT, "utf-8")
    command = [require_node(), "run.mjs", (_ENGINES / "ellipsoids.js").as_uri()]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, encoding="utf-8")
    assert result.returncode == 0, result.stderr
    answer = json.loads(result.stdout)
    for shown in answer["results"]:
        for name in ("centers", "scales", "rotations", "colors"):
            shown[name] = np.reshape(shown[name], (-1, 4))
    return answer


def covariances(shown: dict[str, np.ndarray]) -> np.ndarray:
    turn = Rotation.from_quat(shown["rotations"]).as_matrix()
    axes = turn * shown["scales"][:, None, :3]
    return np.asarray(axes @ axes.transpose(0, 2, 1))


def rows_of(matrices: np.ndarray, centers: np.ndarray) -> np.ndarray:
    upper = matrices[:, *np.triu_indices(3)]
    return np.hstack([centers, np.full((len(centers), 1), 0.6), upper]).astype(np.float32)


def random_matrices(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return covariances of all shapes: balls, needles, discs, points, and axes that are none."""
    scales = np.exp(rng.uniform(-6, 2, (count, 3)))
    scales[: count // 8] = scales[: count // 8, :1]
    scales[count // 8 : count // 4, 0] = 0
    scales[count // 4 : count // 3, :2] = scales[count // 4 : count // 3, :1]
    scales[0] = 0
    turns = Rotation.random(count, random_state=rng).as_matrix()
    turns[count // 3 : count // 2] = np.eye(3)
    axes = turns * scales[:, None]
    return np.asarray(axes @ axes.transpose(0, 2, 1))


@pytest.mark.parametrize("stretch", [None, [[0, 2, 0, 1], [-1, 0, 0.3, 2], [0, 0, 1.5, 3]]])
def test_ellipsoids_have_the_covariances_of_the_rows(stretch: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    count = 240
    rows = rows_of(random_matrices(rng, count), rng.normal(size=(count, 3)))
    transform = _IDENTITY.copy()
    if stretch is not None:
        transform[:3] = stretch
    format = {"capacity": count, "channels": 3, "space": "rgb"}
    format["transform"] = transform.ravel().tolist()
    appearance = rng.uniform(-0.2, 1, (count, 3)).astype(np.float32)
    frame = {"rows": rows, "appearance": appearance, "live": count}
    answer = written(tmp_path, format, [frame])
    [shown] = answer["results"]
    linear = transform[:3, :3]
    matrices = np.zeros((count, 3, 3))
    matrices[:, *np.triu_indices(3)] = rows[:, 4:]
    matrices = np.triu(matrices) + np.triu(matrices, 1).transpose(0, 2, 1)
    expected = linear @ matrices @ linear.T
    error = np.abs(covariances(shown) - expected).max(axis=(1, 2))
    assert (error <= 1e-6 * np.abs(expected).max(axis=(1, 2)) + 1e-30).all()
    np.testing.assert_allclose(np.linalg.norm(shown["rotations"], axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(
        shown["centers"][:, :3], rows[:, :3] @ linear.T + transform[:3, 3], rtol=1e-5, atol=1e-6
    )
    np.testing.assert_allclose(shown["colors"][:, :3], np.maximum(appearance, 0), rtol=1e-6)
    reach = 3 * np.sqrt(np.einsum("nii->ni", expected))
    np.testing.assert_allclose(shown["low"], (shown["centers"][:, :3] - reach).min(0), rtol=1e-5)
    np.testing.assert_allclose(shown["high"], (shown["centers"][:, :3] + reach).max(0), rtol=1e-5)
    assert answer["needsCamera"] is False


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_colours_of_harmonics_are_those_of_the_eye(degree: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(degree)
    count, numbers = 40, (degree + 1) ** 2
    centers = rng.normal(size=(count, 3))
    rows = rows_of(random_matrices(rng, count), centers)
    appearance = rng.normal(0, 0.3, (count, numbers, 3)).astype(np.float32)
    eyes: list[list[float] | None] = [None, [1.0, 2.0, -9.0], [3.0, 2.0, -9.0]]
    frames = [{"rows": rows, "appearance": appearance, "live": count, "eye": eye} for eye in eyes]
    format = {"capacity": count, "channels": 3 * numbers, "space": "sh"}
    answer = written(tmp_path, format, frames)
    assert answer["needsCamera"] is (degree > 0)
    for shown, eye in zip(answer["results"], eyes, strict=True):
        offsets = rows[:, :3] - np.array(eye if eye else [0, 0, 0])
        directions = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
        weights = sh_basis(directions, degree)[:, : numbers if eye else 1]
        part = appearance[:, : numbers if eye else 1]
        expected = np.maximum(0.5 + np.einsum("nk,nkc->nc", weights, part), 0)
        np.testing.assert_allclose(shown["colors"][:, :3], expected, atol=2e-6)


def test_rows_that_are_not_live_or_not_finite_are_not_drawn(tmp_path: Path) -> None:
    rows = rows_of(np.repeat(np.eye(3)[None], 5, axis=0), np.zeros((5, 3)))
    broken = rows.copy()
    broken[0, 5] = np.nan
    broken[1, 3] = 0
    colors = np.full((5, 3), 0.5)
    other = np.full((5, 3), 0.25)
    frames = [
        {"rows": rows, "appearance": colors, "live": 2},
        {"rows": rows, "appearance": colors, "live": 5},
        {"rows": broken, "appearance": other, "live": 3},
        {"rows": rows, "appearance": other, "live": 4},
    ]
    format = {"capacity": 5, "channels": 3, "space": "rgb"}
    results = written(tmp_path, format, frames)["results"]
    opacities = [np.round(shown["colors"][:, 3], 3).tolist() for shown in results]
    assert opacities == [[0.6, 0.6, 0, 0, 0], [0.6] * 5, [0, 0, 0.6, 0, 0], [0.6, 0.6, 0.6, 0.6, 0]]
    for shown, live, color in zip(results, (2, 5, 3, 4), (0.5, 0.5, 0.25, 0.25), strict=True):
        assert (shown["colors"][:live, :3] == color).all()
        assert all(np.isfinite(shown[name]).all() for name in ("centers", "scales", "rotations"))


def test_linear_colours_are_encoded(tmp_path: Path) -> None:
    rows = rows_of(np.repeat(np.eye(3)[None], 6, axis=0), np.zeros((6, 3)))
    light = np.linspace(-0.1, 1.5, 18).reshape(6, 3)
    format = {"capacity": 6, "channels": 3, "space": "rgb", "colorSpace": "linear"}
    frames = [{"rows": rows, "appearance": light, "live": 6}]
    [shown] = written(tmp_path, format, frames)["results"]
    expected = srgb_of_linear(np.maximum(light, 0))
    np.testing.assert_allclose(shown["colors"][:, :3], expected, atol=1e-6)
    zeros = np.log(np.ones((6, 3)))  # of harmonics, whose colour is grey
    frames = [{"rows": rows, "appearance": zeros, "live": 6}]
    [shown] = written(tmp_path, format | {"space": "sh"}, frames)["results"]
    np.testing.assert_allclose(
        shown["colors"][:, :3], srgb_of_linear(np.full((6, 3), 0.5)), atol=1e-6
    )


def answer_of(script: str) -> str:
    """Return what a module prints that has the adapters in its scope."""
    names = {"Babylon": "babylon", "PlayCanvas": "playcanvas", "Spark": "spark"}
    imports = "".join(
        f'import {{ {name}Gaussians }} from "{(_ENGINES / f"{module}.js").as_uri()}";\n'
        for name, module in names.items()
    )
    command = [require_node(), "--input-type=module", "-e", imports + script]
    result = subprocess.run(command, capture_output=True, text=True, encoding="utf-8")
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_older_engines_are_refused() -> None:
    answer = answer_of("""
    for (const open of [
      () => new PlayCanvasGaussians({ version: "2.7.0" }, null, null),
      () => new BabylonGaussians({ Engine: { Version: "7.0.0" } }, null, null),
      () => new BabylonGaussians({ Engine: { Version: "8.0.0" }, GaussianSplattingMesh: class { updateData() {} } }, null, null),
      () => new SparkGaussians({ PackedSplats: null }, null),
    ]) try { open(); } catch (error) { console.log(error.name, error.message); }
    """)
    assert answer.splitlines() == [
        "GsgenError playcanvas is 2.7.0, expected 2.23 or later",
        "GsgenError babylonjs is 7.0.0, expected 9.35 or later",
        "GsgenError babylonjs is 8.0.0, expected 9.35 or later",
        "GsgenError @sparkjsdev/spark is older, expected 2.2 or later",
    ]
    peers = json.loads((CLIENT / "package.json").read_text("utf-8"))["peerDependencies"]
    ranges = {name: peers[name] for name in ("babylonjs", "playcanvas", "@sparkjsdev/spark")}
    assert ranges == {
        "babylonjs": ">=9.35.0 <10.0.0",
        "playcanvas": ">=2.23.0 <3.0.0",
        "@sparkjsdev/spark": ">=2.2.0 <3.0.0",
    }


@pytest.mark.parametrize("path", sorted(_ENGINES.glob("*.js")), ids=lambda path: path.stem)
def test_adapters_call_nothing_private_of_an_engine(path: Path) -> None:
    owners = re.findall(r"([\w\])]+)\??\._\w+", path.read_text("utf-8"))
    assert set(owners) <= {"this"}


def test_models_of_mip_splatting_have_other_settings() -> None:
    answer = answer_of("""
    const kinds = [PlayCanvasGaussians, BabylonGaussians, SparkGaussians];
    const settings = ["classic", "mip"].map((antialias) => kinds.map((kind) => kind.settings({ antialias })));
    console.log(JSON.stringify(settings));
    """)
    assert json.loads(answer) == [
        [{"antiAlias": False}, {"compensation": False}, {"preBlurAmount": 0.3, "blurAmount": 0}],
        [{"antiAlias": True}, {"compensation": True}, {"preBlurAmount": 0, "blurAmount": 0.3}],
    ]


@pytest.mark.parametrize("is_right_handed", [False, True])
def test_rows_for_babylon_are_sorted_and_keep_their_gaussians(is_right_handed: bool) -> None:
    rng = np.random.default_rng(11)
    count = 200
    centers = rng.normal(size=(count, 3)).astype(np.float32)
    rows = rows_of(random_matrices(rng, count), centers)
    colors = rng.uniform(size=(count, 3)).astype(np.float32)
    ahead = np.array([0.3, -0.5, 0.8, 2.0])  # of the matrix to the view, its depth
    words = {"rows": rows.ravel().tolist(), "colors": colors.ravel().tolist()}
    words |= {"ahead": ahead.tolist(), "isRight": is_right_handed}
    answer = answer_of(
        f"const words = {json.dumps(words)};"
        + """
    const toView = new Float32Array(16);
    words.ahead.forEach((number, index) => (toView[2 + 4 * index] = number));
    const world = { multiply: () => ({ m: toView }), clone: () => world, invert: () => world };
    let shown;
    class GaussianSplattingMesh {
      constructor(name, url, scene) { Object.assign(this, { scene, scaling: { z: 1 }, material: {} }); }
      getScene() { return this.scene; }
      computeWorldMatrix() { return world; }
      set disableDepthSort(isOff) { this.isOff = isOff; }
      updateData(data) { shown = new Uint8Array(data.slice(0)); }
    }
    const Vector3 = { TransformCoordinates: () => ({ asArray: () => [0, 0, 0] }) };
    const babylon = { Engine: { Version: "9.35.0" }, Vector3, GaussianSplattingMesh };
    const capacity = words.rows.length / 10;
    const format = { capacity, channels: 3, space: "rgb", antialias: "classic",
      transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] };
    const person = new BabylonGaussians(babylon, { useRightHandedSystem: words.isRight }, format);
    const frame = { rows: new Float32Array(words.rows), appearance: new Float32Array(words.colors), live: capacity };
    person.fill(frame, { getViewMatrix: () => null });
    console.log(JSON.stringify([[...shown], person.mesh.isOff, person.mesh.scaling.z]));
    """
    )
    data, is_off, mirror = json.loads(answer)
    assert is_off
    assert mirror == (1 if is_right_handed else -1)
    table = np.array(data, np.uint8).reshape(count, 32)
    floats = table[:, :24].copy().view(np.float32)
    depths = floats[:, :3] @ ahead[:3] * (-1 if is_right_handed else 1)
    assert (np.diff(depths) <= 1e-4).all()  # farthest first
    # Rows are those of the model, in this order.
    order = np.abs(floats[:, None, :3] - centers[None]).sum(axis=-1).argmin(axis=1)
    assert sorted(order) == list(range(count))
    np.testing.assert_allclose(table[:, 24:27] / 255, colors[order], atol=0.51 / 255)
    np.testing.assert_allclose(table[:, 27] / 255, 0.6, atol=0.51 / 255)
    quaternion = table[:, 28:].astype(np.float64) / 127.5 - 1
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    turn = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    axes = turn * floats[:, None, 3:6]
    matrices = np.zeros((count, 3, 3))
    matrices[:, *np.triu_indices(3)] = rows[order, 4:]
    matrices = np.triu(matrices) + np.triu(matrices, 1).transpose(0, 2, 1)
    error = np.abs(axes @ axes.transpose(0, 2, 1) - matrices).max(axis=(1, 2))
    assert (error <= 0.02 * np.abs(matrices).max(axis=(1, 2)) + 1e-15).all()


@pytest.mark.parametrize("path", sorted(_ENGINES.glob("*.js")), ids=lambda path: path.stem)
def test_adapters_are_small(path: Path) -> None:
    own = path.read_bytes() + (_ENGINES / "ellipsoids.js").read_bytes()
    assert len(gzip.compress(own)) <= 6 * 1024


def test_lines_of_the_guide_are_lines_of_the_examples() -> None:
    guide = (ROOT / "docs/guides/models-in-other-engines.md").read_text("utf-8")
    blocks = re.findall(r"<!-- lines of: (\S+) -->\n```js\n(.*?)```", guide, re.DOTALL)
    assert len(blocks) == guide.count("```js")
    for path, block in blocks:
        lines = {line.strip() for line in (ROOT / path).read_text("utf-8").splitlines()}
        assert [line for line in block.splitlines() if line.strip() not in lines] == []
