"""Single modules of the browser client, by vectors that Python computes."""

import json
import random
import re
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from gsgen.conformance.fixtures.valid.scene_inputs import posed_picture_model
from gsgen.runtime.kernels.project.project import FRAME, PAGE, frame_uniform, page_uniforms
from gsgen.runtime.playback.picture_inputs import picture_tracks
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Box, SplatSet
from gsgen.runtime.sources.source import GeneratorSource
from gsgen.runtime.web.pages import client_file
from support.rendering.splat_scenes import cloud, turned
from support.web.pages import CLIENT, WebSite, unpacked
from support.web.scenes import camera_of, set_of
from web_client.formulas import evaluate

pytestmark = pytest.mark.slow


def test_every_shader_module_compiles_without_a_message(site: WebSite) -> None:
    result = site.call("compile")
    assert result["count"] > 20
    unreachable = {"warning: code is unreachable"}
    messages = {name: set(texts) - unreachable for name, texts in result["messages"].items()}
    assert {name: texts for name, texts in messages.items() if texts} == {}


def formulas_of(value: Any) -> list[Any]:
    """Return all formulas within a JSON value: lists that start with an operator's name."""
    if isinstance(value, dict):
        return [formula for part in value.values() for formula in formulas_of(part)]
    if not isinstance(value, list):
        return []
    inner = [formula for part in value for formula in formulas_of(part)]
    is_formula = bool(value) and isinstance(value[0], str) and not isinstance(value[-1], str)
    return [value, *inner] if is_formula and len(value) in (2, 3) else inner


OPERATORS = {"add", "sub", "mul", "floor_div", "ceil_div", "abs", "bits", "le"}
"""The operators that plans have, and the client."""

OTHER_OPERATORS = {"mod", "neg", "lt", "gt", "ge", "eq", "ne"}
"""Operators that only recorded formulas may have."""


def test_formulas_have_the_values_of_python(site: WebSite) -> None:
    """Every formula of the plans at random sizes, and every operator at random operands."""
    rng = random.Random(0)
    names = (
        "width",
        "height",
        "pairs",
        "gaussians",
        "pages",
        "capacity",
        "slot",
        "cells",
        "set_cells",
        "slots",
    )
    document = json.loads(client_file("plans.json"))
    formulas = [
        formula
        for table in ("buffers", "binds", "steps", "plans")
        for formula in formulas_of(document[table])
        if formula[0] in OPERATORS | OTHER_OPERATORS
    ]
    unique = list({repr(formula): formula for formula in formulas}.values())
    assert len(unique) > 30
    cases = [
        (formula, {name: rng.randint(0, 1 << 24) for name in names})
        for formula in unique
        for _ in range(5)
    ]
    assert {formula[0] for formula in unique} <= OPERATORS
    for name in sorted(OPERATORS - {"abs", "bits"}):
        pairs = [(rng.randint(-99, 99), rng.choice([-7, -1, 1, 2, 64])) for _ in range(40)]
        cases += [([name, a, b], {}) for a, b in pairs]
    for name in ("abs", "bits"):
        cases += [([name, a], {}) for a in (0, 1, -5, 255, 256, (1 << 40) + 1)]
    assert site.call("evaluateAll", cases) == [evaluate(*case) for case in cases]


def random_camera(rng: random.Random, number: int) -> Camera:
    width, height = rng.randint(1, 4000), rng.randint(1, 4000)
    far = 10 ** rng.uniform(-1, 6)
    eye = [far * rng.uniform(-1, 1) for _ in range(3)]
    target = [x + rng.uniform(-3, 3) for x in eye]
    camera = Camera.look_at(eye, target, up=(0.1, -1, 0.2), width=width, height=height,
                            fov_y=rng.uniform(5, 150), near=10 ** rng.uniform(-3, 1))  # fmt: skip
    if number % 3 == 1:
        return camera.flattened(rng.uniform(0.5, 20))
    return camera.panorama_around(width, height) if number % 3 == 2 else camera


def random_set(rng: random.Random, number: int) -> SplatSet:
    scale: Any = rng.uniform(0.1, 10)
    if number % 4 == 3:
        scale = [rng.choice([-1, 1]) * rng.uniform(0.3, 3) for _ in range(3)]
    transform = turned(rng.uniform(-3, 3), (1, rng.uniform(-1, 1), rng.uniform(-1, 1)), scale)
    transform[:3, 3] = [rng.uniform(-1, 1) * 10 ** rng.uniform(-1, 5) for _ in range(3)]
    if number % 5 == 4:
        transform[0, 1] += rng.uniform(-0.5, 0.5)
    clip = Box((-1, -2, -3), (4, 5, 6)) if number % 2 else None
    return SplatSet(
        cloud(3, number, degree=(None, 0, 1, 2, 3)[number % 5]),
        transform if number else np.eye(4),
        opacity_scale=rng.uniform(0.1, 2),
        antialias="mip" if number % 3 else "classic",
        clip=clip,
    )


def test_uniforms_are_those_of_python(site: WebSite) -> None:
    """Of 240 cameras with a set each: 1 ulp, or 1e-7 of the largest number of a matrix."""
    rng = random.Random(1)
    cases, expected = [], []
    for number in range(240):
        camera, splat_set = random_camera(rng, number), random_set(rng, number)
        background = [rng.random() for _ in range(3)]
        numbers = {"base": 7 * number, "capacity": 3, "count": number % 4}
        page = {"set": set_of(splat_set), **numbers}
        page["set"].pop("splats")
        cases.append({"camera": camera_of(camera), "background": background, "pages": [page] * 2})
        pages = [(splat_set, *numbers.values())] * 2
        expected.append((frame_uniform(camera, np.array(background)), page_uniforms(pages, camera)))
    for (frame, page), texts in zip(expected, site.call("uniformsOf", cases), strict=True):
        same_fields(unpacked(texts[0], np.uint8).view(FRAME), frame.reshape(1), FRAME)
        same_fields(unpacked(texts[1], np.uint8).view(PAGE), page, PAGE)


_EXTENT_OF = {"linear_rest": "linear", "eye_rest": "eye", "eye_at": "eye", "eye_at_rest": "eye"}
"""Rounding errors are as exact as the numbers that they belong to."""


def same_fields(actual: np.ndarray, expected: np.ndarray, dtype: np.dtype[np.void]) -> None:
    assert dtype.names is not None
    for name in dtype.names:
        field, other = actual[name], expected[name]
        if field.dtype.kind == "u":
            np.testing.assert_array_equal(field, other, err_msg=name)
            continue
        # float64 has 29 bits more than float32: rests of numbers agree to as many, less a few.
        extent = np.abs(expected[_EXTENT_OF[name]]).max() * 1e-13 if name in _EXTENT_OF else 0.0
        if name in ("local_to_sh", "linear", "forward") or name == "eye":
            extent = 1e-7 * np.abs(other).max()
        np.testing.assert_allclose(field, other, rtol=1.2e-7, atol=float(extent), err_msg=name)


def test_no_kernel_is_written_in_javascript() -> None:
    """Stages, kernels, buffers and workgroup sizes stand in plans.json alone."""
    document = json.loads(client_file("plans.json"))
    names = {stage for plan in document["plans"] for stage in plan["stages"]}
    names |= {row["label"] for row in document["modules"]}
    names |= {row["entry"] for row in document["pipelines"]}
    names |= {re.sub(r" \d+$", "", row["label"]) for row in document["buffers"]}
    # Words of inputs and outputs of a plan, of a page, or of a scene file; not a kernel's own.
    names -= {
        "blend",
        "frame",
        "pages",
        "counts",
        "color",
        "depth",
        "normal",
        "present",
        "count",
        "scan",
        "sort",
        "layer colors",
        "layer depths",
    }
    paths = [path for path in CLIENT.rglob("*.js") if path.name != "contract_rules.js"]
    texts = {path.name: path.read_text("utf-8") for path in paths}
    assert "host.js" in texts
    for file, text in texts.items():
        strings = set(re.findall(r'"([^"\n]*)"', text))
        assert strings & names == set(), file
        assert "@compute" not in text, file
        assert "workgroup_size" not in text, file
        assert not re.search(r"dispatchWorkgroups\(\s*\d", text), file


def test_views_are_those_of_python(site: WebSite) -> None:
    """At random, and along the upward axis, where another axis takes its place."""
    rng = random.Random(2)
    poses = [([rng.uniform(-5, 5) for _ in range(3)], [rng.uniform(-5, 5) for _ in range(3)],
              (0, 0, 1)) for _ in range(20)]  # fmt: skip
    for eye, target, up in [*poses, ([0, 3, 0], [0, 0, 0], (0, -1, 0))]:
        camera = Camera.look_at(eye, target, up=up, width=8, height=6)
        result = site.call("viewTowards", eye, target, list(up))
        np.testing.assert_allclose(result, camera.view.ravel(), atol=1e-12)


def test_a_plan_that_no_guard_allows_is_an_error(site: WebSite) -> None:
    with pytest.raises(Exception, match="no frame plan draws color at 70000×70000"):
        site.call("choose", {"outputs": ["color"], "panorama": False, "deep": False, "weighted": False},
                  {"width": 70_000, "height": 70_000})  # fmt: skip


_PICTURE_CAMERAS = """async ([text, names, pictures, size]) => {
  const { pictureCameras } = await import("/client/pictures.js");
  const address = URL.createObjectURL(new Blob([text]));
  try {
    return await pictureCameras(address, names, pictures, size);
  } catch (error) {
    return { error: error.message.replace(address, "FILE"), hint: error.hint };
  }
}"""


def transforms(rng: np.random.Generator, *, lens: dict[str, Any]) -> dict[str, Any]:
    """Return a transforms.json of two turned cameras, in another order than the pictures."""
    frames = []
    for name in ("images/b.png", "images/a.png"):
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        matrix[:3, 3] = rng.normal(size=3)
        frames.append({"file_path": name, "transform_matrix": matrix.tolist()})
    return {**lens, "frames": frames}


@pytest.mark.parametrize(
    "lens",
    [
        {"camera_angle_x": 0.7},
        {"camera_angle_x": 0.7, "camera_angle_y": 0.6},
        {"fl_x": 40.0, "fl_y": 41.0, "cx": 17.0, "cy": 11.5, "w": 36, "h": 24},
        {"fl_y": 41.0, "w": 18, "h": 12},
        None,
    ],
)
def test_cameras_of_pictures_are_those_of_python(
    lens: dict[str, Any] | None, site: WebSite, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    sizes = ((36, 24), (72, 48))
    files = [tmp_path / name for name in ("a.png", "b.png")]
    for file, (width, height) in zip(files, sizes, strict=True):
        Image.fromarray(np.zeros((height, width, 3), np.uint8)).save(file)
    if lens is None:  # cameras of gsgen, in order
        cameras = [random_camera(random.Random(number), number) for number in range(2)]
        scaled = [replace(c.resized(36, 24), kind="pinhole", distortion=None) for c in cameras]
        document: Any = [json.loads(camera.to_json()) for camera in scaled]
    else:
        document = transforms(rng, lens=lens)
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(document), "utf-8")
    posed_picture_model().write(tmp_path / "model.onnx")
    with closing(GeneratorSource(tmp_path / "model.onnx")) as source:
        tracks = picture_tracks([",".join(map(str, files))], str(path), [source])
        rows, columns = source.shape("image")[2:]
    expected = {track.input_name: track.values for track in tracks}
    names = [f"http://host/pictures/{file.name}?version=2" for file in files]
    pictures = [{"width": width, "height": height} for width, height in sizes]
    arguments = [path.read_text("utf-8"), names, pictures, [rows, columns]]
    actual = site.page.evaluate(_PICTURE_CAMERAS, arguments)
    for role, name in (("image_view", "poses"), ("image_intrinsics", "lenses")):
        np.testing.assert_allclose(actual[role], expected[name].ravel(), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("{", "is no JSON"),
        ('{"frames": [{}, {}], "w": 3, "h": 2, "fl_x": 4}', "without a transform_matrix"),
        ('{"frames": []}', "has 0 cameras for 2 pictures of other names"),
        ("[{}, {}]", "has no lens or view for picture 0"),
        ("7", "has 1 cameras for 2 pictures"),
    ],
)
def test_a_file_of_other_cameras_is_refused_with_a_hint(
    document: str, message: str, site: WebSite
) -> None:
    pictures = 2 * [{"width": 36, "height": 24}]
    result = site.page.evaluate(_PICTURE_CAMERAS, [document, ["a.png", "b.png"], pictures, [4, 6]])
    assert message in result["error"]
    assert "transforms.json" in result["hint"]


def test_lenses_that_no_picture_input_has_are_refused(site: WebSite) -> None:
    lens = {"fl_x": 40.0, "camera_model": "OPENCV_FISHEYE"}
    document = json.dumps(transforms(np.random.default_rng(0), lens=lens))
    pictures = 2 * [{"width": 36, "height": 24}]
    result = site.page.evaluate(_PICTURE_CAMERAS, [document, ["a.png", "b.png"], pictures, [4, 6]])
    assert "has a fisheye camera for picture 0, expected one with perspective" in result["error"]
    document = document.replace('"camera_model"', '"other"').replace(
        '"fl_x"', '"w": 9, "h": 24, "fl_x"'
    )
    result = site.page.evaluate(_PICTURE_CAMERAS, [document, ["a.png", "b.png"], pictures, [4, 6]])
    assert "has a camera of 9×24 pixels, but picture 0 has 36×24" in result["error"]
