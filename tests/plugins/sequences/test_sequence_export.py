"""`gsgen export sequence` writes a clip that conforms, plays and draws the frames that it was made of."""

import json
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import write_ply
from gsgen.reference_plugins.sequences.synthetic_sequence import moving_knot, write_sequence
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.opening import open_source
from support.commands import gsgen_here

ROWS, FRAMES = 2000, 12


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a clip that the program wrote from a folder of PLY files, which lies beside it."""
    folder = tmp_path_factory.mktemp("sequence")
    write_sequence(folder / "frames", rows=ROWS, frames=FRAMES)
    path = folder / "clip.onnx"
    options = ("--fps", "24", "--report", str(folder / "report.json"))
    ran = gsgen_here("export", "sequence", str(folder / "frames"), "-o", str(path), *options)
    assert ran.code == 0, ran.err
    assert f"{FRAMES} frames of {ROWS:,} Gaussians" in ran.out
    assert "drawn at 2 frames and 2 moments between: PSNR" in ran.out
    return path


def test_the_report_has_the_bytes_and_the_loss(clip: Path) -> None:
    measured = json.loads((clip.parent / "report.json").read_text("utf-8"))["measured"]
    assert (measured["frames"], measured["rows"]) == (FRAMES, ROWS)
    assert 0.9 * measured["file_bytes"] - 60_000 < sum(measured["table_bytes"].values())
    loss = measured["loss"]
    assert [moment["frame"] for moment in loss["moments"]] == [0, 11, 0.5, 10.5]
    assert loss["psnr_worst"] == min(moment["psnr"] for moment in loss["moments"]) > 45
    assert loss["ssim_mean"] > 0.99
    assert loss["worst_frame"].endswith(".ply")


def test_the_clip_conforms_and_is_smaller_than_its_frames(clip: Path) -> None:
    ran = gsgen_here("validate", str(clip), "--json")
    report = json.loads(ran.out)
    assert (ran.code, report["verdict"]) == (0, "conforms")
    assert not [finding for finding in report["findings"] if finding["severity"] != "info"]
    total = sum(path.stat().st_size for path in (clip.parent / "frames").iterdir())
    assert clip.stat().st_size < 0.05 * total


def test_drawn_moments_are_drawn_frames(clip: Path) -> None:
    frames, played = open_source(clip.parent / "frames"), open_source(clip)
    renderer = Renderer()
    camera = Camera.look_at((1.2, -1.0, -3.2), (0, 0, 0), width=200, height=150, fov_y=50.0)
    ratios = []
    for number in (0, 5, 11):
        pictures = []
        for source, values in (
            (frames, {"frame": np.array([number], np.int32)}),
            (played, {"time": np.array([number / FRAMES], np.float32)}),
        ):
            source.update(camera, values, number)
            scene = Scene([source.splats(None, source.antialias)])
            rgba = renderer.render(scene, camera, background=(0, 0, 0, 1)).rgba
            assert rgba is not None
            pictures.append(np.clip(rgba[..., :3], 0, 1))
        assert pictures[1].max() > 0.5
        ratios.append(psnr(pictures[1], pictures[0]))
    assert min(ratios) > 45


def test_a_pattern_a_list_and_a_folder_give_the_same_bytes(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(clip.parent)
    files = sorted(str(path) for path in Path("frames").iterdir())
    for frames in (["frames/%04d.ply"], files):
        path = tmp_path / "clip.onnx"
        options = ("-o", str(path), "--fps", "24", "--level", "static", "--moments", "0")
        assert gsgen_here("export", "sequence", *frames, *options).code == 0
        assert path.read_bytes() == clip.read_bytes()


def test_files_that_are_not_a_sequence_are_refused(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_ply("a.ply", moving_knot(0.0, 20))
    write_ply("b.ply", moving_knot(0.5, 30))
    Path("empty").mkdir()
    quality = ["a.ply", "b.ply", "--quality", "50", "--error", "0.1"]
    for frames, message in (
        (quality, "--quality: is given beside --error"),
        (["a.ply"], "has 1 frame, expected two or more"),
        (["empty"], "empty: is not a folder of two or more numbered splat files"),
        (["frames/%d.ply"], "frames/%d.ply"),
    ):
        ran = gsgen_here("export", "sequence", *frames, "-o", "clip.onnx")
        assert ran.code not in (0, 70), ran.err
        assert message in ran.err
        assert "Traceback" not in ran.err
        assert not Path("clip.onnx").exists()
