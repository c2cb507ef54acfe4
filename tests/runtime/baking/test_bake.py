"""Baked files against the generators that they come from."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.spherical_harmonics import evaluate
from gsgen.formats import Splats, open_splats
from gsgen.runtime.baking import BakeReport, bake
from gsgen.runtime.baking.frame_values import number_range
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.source import GeneratorSource, Source, StillFrameSource
from gsgen.sdk.binding import FrameSession

CAMERA = Camera.orbit((0, 0, 0), 6, azimuth=50, elevation=-35, width=160, height=120)


def _splats(path: str | Path) -> Splats:
    content = open_splats(path)
    assert isinstance(content, Splats)
    return content


def _image(source: Source, renderer: Renderer) -> np.ndarray:
    frame = renderer.render(Scene([source.splats(None, None)]), CAMERA)
    assert frame.rgba is not None
    return frame.rgba


def _psnr(
    model: Path, file: Path, renderer: Renderer, values: dict[str, object] | None = None
) -> float:
    source = GeneratorSource(model)
    try:
        source.update(CAMERA, values or {})
        expected = _image(source, renderer)
    finally:
        source.close()
    assert expected[..., 3].max() > 0.5
    error = float(np.mean(np.square(_image(StillFrameSource(file), renderer) - expected)))
    return -10 * np.log10(max(error, 1e-20))


@pytest.mark.parametrize("time", [0.0, 0.7])
def test_a_frame_has_the_rows_of_the_model(
    models: Path, tmp_path: Path, renderer: Renderer, time: float
) -> None:
    model, file = models / "drift.onnx", tmp_path / "drift.ply"
    report = bake(model, file, time=time)
    with FrameSession(model, provider="cpu") as session:
        rows = session.run({"time": time}).gaussians()
    splats = _splats(file)
    np.testing.assert_array_equal(splats.position, rows.position)
    np.testing.assert_array_equal(splats.sh, rows.sh)
    scale = np.exp(splats.log_scale.astype(np.float64))
    again = covariance_upper(scale, splats.rotation.astype(np.float64))
    np.testing.assert_allclose(again, rows.covariance, atol=1e-7)
    assert (report.view_dependence, report.frames[0].count) == ("none", len(rows))
    assert _psnr(model, file, renderer, {"time": time}) >= 60


def test_only_live_rows_are_written(models: Path, tmp_path: Path) -> None:
    report = bake(models / "growing.onnx", tmp_path / "%d.ply", time=np.array([0, 0.5, 1]))
    assert [frame.count for frame in report.frames] == [5, 10, 15]
    assert [len(_splats(frame.file)) for frame in report.frames] == [5, 10, 15]
    assert [frame.time for frame in report.frames] == [0, 0.5, 1]


def test_known_harmonics_are_recovered(models: Path, tmp_path: Path, renderer: Renderer) -> None:
    model, file = models / "harmonic.onnx", tmp_path / "harmonic.ply"
    report = bake(model, file)
    splats = _splats(file)
    assert (splats.degree, report.view_dependence) == (2, "colors")
    assert report.frames[0].psnr is not None
    assert report.frames[0].psnr >= 60
    assert _psnr(model, file, renderer) >= 60
    rng = np.random.default_rng(3)
    with FrameSession(model, provider="cpu") as session:
        for _ in range(5):
            eye = rng.normal(size=3) * 5
            expected = session.run({"camera_position": eye}).appearance[:, :3]
            rays = splats.position - eye
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            colors = evaluate(splats.sh, rays)[np.arange(len(rays)), np.arange(len(rays))]
            np.testing.assert_allclose(colors, np.maximum(expected, 0), atol=2e-3)


def test_a_network_of_the_view_is_fitted(models: Path, tmp_path: Path, renderer: Renderer) -> None:
    """The network of this model also makes the opacity: the mean stands for all cameras."""
    report = bake(models / "lit.onnx", tmp_path / "lit.ply")
    assert report.view_dependence == "rows and colors"
    assert "Gaussians depend on the camera" in report.notes[0]
    assert len(report.fit_error) == 4
    # How much harmonics explain depends on the random network: 2.4 to 4 times with these sizes.
    assert report.fit_error[report.frames[0].sh_degree] < report.fit_error[0] / 2
    assert report.frames[0].psnr is not None
    assert report.frames[0].psnr >= 40
    assert _psnr(models / "lit.onnx", tmp_path / "lit.ply", renderer) >= 40


def test_single_camera_bakes_its_visible_gaussians(
    models: Path, tmp_path: Path, renderer: Renderer
) -> None:
    report = bake(models / "lit.onnx", tmp_path / "lit.ply", camera=CAMERA)
    assert (report.view_dependence, report.frames[0].sh_degree) == ("camera", 0)
    assert _psnr(models / "lit.onnx", tmp_path / "lit.ply", renderer) >= 60


def test_rows_that_move_up_are_matched(models: Path, tmp_path: Path) -> None:
    """Half of the rows are live at each camera; the file has all of them, with their colours."""
    report = bake(models / "halfseen.onnx", tmp_path / "half.ply", psnr=False)
    splats = _splats(tmp_path / "half.ply")
    order = np.lexsort(splats.position.T)
    seeded = np.lexsort(_all_positions(models).T)
    np.testing.assert_array_equal(splats.position[order], _all_positions(models)[seeded])
    assert report.view_dependence == "rows and colors"
    with FrameSession(models / "halfseen.onnx", provider="cpu") as session:
        live = session.run({"camera_position": np.array([9.0, 0, 0])}).gaussians()
    index = {row.tobytes(): n for n, row in enumerate(splats.position)}
    matches = [index[row.tobytes()] for row in live.position]
    color = 0.5 + splats.sh[matches, 0] / (2 * np.sqrt(np.pi))
    np.testing.assert_allclose(color, live.rgb, atol=1e-3)


def _all_positions(models: Path) -> np.ndarray:
    positions: set[bytes] = set()
    with FrameSession(models / "halfseen.onnx", provider="cpu") as session:
        for sign in (-1.0, 1.0):
            rows = session.run({"camera_position": np.array([sign, 0, 0])}).gaussians()
            positions |= {row.tobytes() for row in rows.position}
    return np.stack([np.frombuffer(row, np.float32) for row in positions])


def test_an_interrupted_sequence_leaves_whole_files(models: Path, tmp_path: Path) -> None:
    def interrupt(text: str) -> None:
        if text.startswith("frame 3 of 5: writing"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bake(
            models / "drift.onnx",
            tmp_path / "seq" / "%04d.ply",
            time=np.linspace(0, 1, 5),
            progress=interrupt,
        )
    names = sorted(path.name for path in (tmp_path / "seq").iterdir())
    assert names == ["0000.ply", "0001.ply"]
    assert [len(_splats(tmp_path / "seq" / name)) for name in names] == [50, 50]


def test_a_range_has_both_ends() -> None:
    np.testing.assert_allclose(number_range("0:1:5", "--time"), [0, 0.25, 0.5, 0.75, 1])
    np.testing.assert_array_equal(number_range("0.3", "--time"), [0.3])
    np.testing.assert_array_equal(number_range("2:5:1", "--time"), [2])


@pytest.mark.parametrize(
    "text", ["", "a", "0:1", "0:1:2:3", "0:1:x", "0:1:0", "0:1:-3", "nan", "0:inf:3", "::"]
)
def test_invalid_ranges_are_refused(text: str) -> None:
    with pytest.raises(ConfigInvalid, match="--time"):
        number_range(text, "--time")


def _bake(model: Path, output: Path, **options: object) -> BakeReport:
    return bake(model, output, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("model", "output", "options", "message"),
    [
        ("drift", "a.ply", {"time": 2.0}, "is 2 for input time, expected 0 to 1"),
        ("lit", "a.ply", {"time": 0.5}, "has no time input"),
        ("drift", "a.ksplat", {}, "KSPLAT can only be read"),
        ("drift", "a.txt", {}, "has the suffix .txt, expected a format"),
        ("drift", "a.ply", {"time": np.array([0, 1])}, "expected a pattern for 2 frames"),
        ("drift", "%d/%d.ply", {"time": np.array([0, 1])}, "has 2 frame numbers"),
        ("drift", "a.ply", {"views": 5}, "the number of cameras is 5, expected 20 or more"),
        ("drift", "a.ply", {"max_degree": 4}, "is 4, expected 0 to 3"),
    ],
)
def test_invalid_options_are_refused_before_a_file_is_written(
    models: Path, tmp_path: Path, model: str, output: str, options: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigInvalid, match=message):
        _bake(models / f"{model}.onnx", tmp_path / output, **options)
    assert not list(tmp_path.iterdir())


def test_unknown_names_are_refused(models: Path, tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="unknown input 'tim'"):
        bake(models / "drift.onnx", tmp_path / "a.ply", values={"tim": 0.5})
    with pytest.raises(UnknownName, match="unknown format 'plyy'"):
        bake(models / "drift.onnx", tmp_path / "a.ply", format="plyy")


def test_tracks_of_different_lengths_are_refused(models: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match="expected 1 or 3"):
        bake(
            models / "drift.onnx",
            tmp_path / "%d.ply",
            time=np.linspace(0, 1, 3),
            values={"time": np.linspace(0, 1, 2)},
        )
