from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.layout import decode
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.formats import PackedRows, PointCloud, open_splats, write_ply
from gsgen.reference_plugins.static.static import from_content, neighbour_scale
from gsgen.reference_plugins.static.static_plugin import _write_demo
from gsgen.reference_plugins.synthetic import torus_knot
from support.commands import gsgen_here, shared
from support.models.static_scenes import write_scene


def run_model(path: Path) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(path)
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(names, {}), strict=True))


def test_neighbour_scale_is_that_of_brute_force() -> None:
    points = np.random.default_rng(0).normal(size=(400, 3))
    squares = np.square(points[:, None] - points[None]).sum(axis=2)
    expected = np.sqrt(np.sort(squares, axis=1)[:, 1:4].mean(axis=1))
    np.testing.assert_allclose(neighbour_scale(points), expected)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_and_equal_points_have_a_size(count: int) -> None:
    result = neighbour_scale(np.zeros((count, 3)))
    np.testing.assert_allclose(result, np.sqrt(1e-7))


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_splats_are_activated_as_the_paper_says(
    tmp_path: Path, degree: int, encoding: str, dtype: str
) -> None:
    splats = torus_knot(64, degree=degree)
    write_ply(tmp_path / "knot.ply", splats, format=encoding)
    scene = from_content(open_splats(tmp_path / "knot.ply"), dtype=dtype)
    gaussians = decode(scene.rows, scene.appearance, "sh")
    exact = 2e-6 if dtype == "float32" else 2e-3
    np.testing.assert_allclose(gaussians.position, splats.position, rtol=exact, atol=exact)
    expected = 1 / (1 + np.exp(-splats.logit_opacity.astype(np.float64)))
    np.testing.assert_allclose(gaussians.opacity, expected, atol=exact)
    assert gaussians.sh is not None
    retained = splats.sh.shape[1]
    np.testing.assert_allclose(gaussians.sh[:, :retained], splats.sh, rtol=exact, atol=exact)
    assert (gaussians.sh[:, retained:] == 0).all()
    scales = np.sort(np.exp(splats.log_scale.astype(np.float64)), axis=1)
    actual = np.sqrt(np.maximum(np.linalg.eigvalsh(symmetric(gaussians.covariance)), 0))
    np.testing.assert_allclose(actual, scales, rtol=0.002 if dtype == "float32" else 0.2)


def test_exported_splats_conform_to_every_target(tmp_path: Path) -> None:
    from gsgen.contract.spec.targets import known_targets

    write_scene(from_content(torus_knot(500)), tmp_path / "m.onnx", capacity=512)
    for target in known_targets().values():
        settings = Settings(target=target, fail_on=Severity.INFO)
        assert validate(tmp_path / "m.onnx", settings).findings == ()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("words", ["--dtype float16", "--target visionary"])
def test_harmonics_are_of_a_degree_that_is_taken(degree: int, words: str, tmp_path: Path) -> None:
    knot = torus_knot(7, degree=degree)
    write_ply(tmp_path / "knot.ply", knot)
    completed = gsgen_here(
        "export", "static", "knot.ply", "-o", "knot.onnx", *words.split(), cwd=tmp_path
    )
    assert completed.code == 0, completed.err
    _, color, _ = onnxruntime.InferenceSession(tmp_path / "knot.onnx").run(None, {})
    expected_width = 48 if "visionary" in words else (12, 12, 48, 48)[degree]
    assert color.shape == (7, expected_width)
    retained = knot.sh.reshape(7, -1)
    np.testing.assert_allclose(color[:, : retained.shape[1]], retained, atol=1e-3)
    assert (color[:, retained.shape[1] :] == 0).all()
    assert ("are written as degree" in completed.err) == (degree in (0, 2) and "float16" in words)


def test_padding_rows_are_zero(tmp_path: Path) -> None:
    write_scene(from_content(torus_knot(10)), tmp_path / "m.onnx", capacity=16)
    outputs = run_model(tmp_path / "m.onnx")
    assert outputs["num_points"].tolist() == [10]
    assert not outputs["gaussians"][10:].any()
    assert outputs["color_sh"].shape == (16, 48)


def test_points_become_gaussians_of_one_tenth_opacity(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(100, 3)).astype(np.float32)
    cloud = PointCloud(points, rng.uniform(0, 1, (100, 3)).astype(np.float32))
    scene = from_content(cloud)
    np.testing.assert_allclose(scene.rows[:, 3], 0.1, rtol=1e-6)
    variance = np.square(neighbour_scale(cloud.position))
    np.testing.assert_allclose(scene.rows[:, [4, 7, 9]], variance[:, None].repeat(3, 1), rtol=1e-5)
    np.testing.assert_array_equal(scene.appearance, cloud.color)
    sh_scene = from_content(cloud, sh_degree=2)
    assert sh_scene.appearance.shape == (100, 27)
    np.testing.assert_allclose(
        0.5 + 0.28209479 * sh_scene.appearance[:, :3], cloud.color, atol=1e-6
    )
    assert not sh_scene.appearance[:, 3:].any()


@pytest.mark.parametrize("channels", [3, 4, 12, 27, 48])
def test_packed_rows_pass_through_bit_for_bit(tmp_path: Path, channels: int) -> None:
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(33, 10)).astype(np.float16)
    color = rng.normal(size=(33, channels)).astype(np.float32)
    rows[3, 2] = np.inf
    color[4, 1] = -0.0
    scene = from_content(PackedRows(rows, color))
    write_scene(scene, tmp_path / "m.onnx")
    outputs = run_model(tmp_path / "m.onnx")
    np.testing.assert_array_equal(outputs["gaussians"].view(np.uint16), rows.view(np.uint16))
    output = outputs["color_rgb" if channels < 5 else "color_sh"]
    np.testing.assert_array_equal(output.view(np.uint32), color.view(np.uint32))


def test_invalid_channel_counts_are_refused() -> None:
    rows = PackedRows(np.zeros((2, 10), np.float32), np.zeros((2, 5), np.float32))
    with pytest.raises(GsgenError, match="5 channels, expected"):
        from_content(rows)


def test_a_capacity_below_the_rows_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GsgenError, match="4 is less than the 10 packed Gaussians"):
        write_scene(from_content(torus_knot(10)), tmp_path / "m.onnx", capacity=4)
    assert list(tmp_path.iterdir()) == []


def test_the_real_garden_exports_and_conforms(tmp_path: Path) -> None:
    garden = shared("data/garden/test_garden.npz")
    completed = gsgen_here(
        "export", "static", garden, "-o", tmp_path / "garden.onnx", "--dtype", "float16"
    )
    assert completed.code == 0, completed.err
    report = validate(tmp_path / "garden.onnx")
    assert report.verdict == "conforms"
    assert report.capacity == 138766
    outputs = run_model(tmp_path / "garden.onnx")
    with np.load(garden) as data:
        np.testing.assert_allclose(
            outputs["gaussians"][:, :3], data["means3d"], rtol=1e-3, atol=1e-3
        )


def test_the_real_splats_export_and_conform(tmp_path: Path) -> None:
    source = shared("data/twins/test-splat.3-points-from-train.ply")
    completed = gsgen_here("export", "static", source, "-o", tmp_path / "three.onnx")
    assert completed.code == 0, completed.err
    assert validate(tmp_path / "three.onnx").capacity == 3


def test_the_demo_names_the_file_that_it_writes(tmp_path: Path) -> None:
    (name,) = _write_demo(tmp_path)
    assert len(open_splats(name)) == 20_000
