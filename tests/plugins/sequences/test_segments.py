"""A scene file of segments plays the frames, resumes, and is the same bytes from any engine."""

import json
import signal
import wave
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.contract import validator
from gsgen.contract.spec import layout
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.formats import Splats, write_ply, write_sog
from gsgen.reference_plugins.sequences.segmented_clip import _is_exported
from gsgen.reference_plugins.sequences.synthetic_sequence import write_sequence
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.scene_file import open_scene
from support.commands import gsgen_here

ROWS, FRAMES, FPS = 300, 9, 10
OPTIONS = ("--fps", str(FPS), "--segment", "0.3", "--level", "static", "--moments", "0")


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of the scene file of a folder, and of its segments."""
    files = [folder / "clip.json", *(folder / "clip").iterdir()]
    return {file.name: file.read_bytes() for file in files if file.is_file()}


def export(folder: Path, *options: str) -> dict[str, bytes]:
    """Export the frames of a folder, and return the bytes of all files that were written."""
    scene = folder / "clip.json"
    ran = gsgen_here("export", "sequence", str(folder / "frames"), "-o", str(scene), *options)
    assert ran.code == 0, ran.err
    assert not (folder / "clip" / ".gsgen-export").exists()
    return contents(folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("segments")
    write_sequence(folder / "frames", rows=ROWS, frames=FRAMES)
    return folder


@pytest.fixture(scope="module")
def written(folder: Path) -> dict[str, bytes]:
    return export(folder, *OPTIONS, "--loop")


def test_segments_last_as_long_as_the_frames(written: dict[str, bytes]) -> None:
    """The first one is a picture of its own; a loop ends in its first frame."""
    assert set(written) == {"clip.json", "0000.sog", "0001.onnx", "0002.onnx", "0003.onnx"}
    document = json.loads(written["clip.json"])
    (model,) = document["models"]
    assert model["capacity"] == ROWS
    seconds = [segment["seconds"] for segment in model["segments"]]
    np.testing.assert_allclose(seconds, [0.1, 0.3, 0.3, 0.2])
    assert document["timeline"] == {"seconds": FRAMES / FPS, "fps": FPS, "loop": True}


@pytest.mark.usefixtures("written")
def test_every_moment_is_that_of_the_frames(folder: Path) -> None:
    """Also at the seams, in any order, and half-way between frames of different segments."""
    frames = open_source(folder / "frames")
    (source,) = open_scene(folder / "clip.json")
    positions = []
    for number in range(FRAMES):
        frames.update(None, {"frame": np.array([number])})
        rows = frames.data.rows[:ROWS].astype(np.float64)
        positions.append(rows[rows[:, layout.OPACITY] > 0.05, layout.POSITION])
    try:
        for number in (8, 0, 4, 3, 1, 7, 6):
            source.update(None, {"time": number / FPS})
            assert nearest(source.data.rows[: source.count], positions[number]) < 0.02
        before, after = ends_of(source, 4 / FPS)
        np.testing.assert_allclose(before, after, atol=0.02)
    finally:
        source.close()


def nearest(rows: np.ndarray, expected: np.ndarray) -> float:
    distances = np.linalg.norm(rows[None, :, :3] - expected[:, None], axis=2)
    return float(distances.min(axis=1).max())


def ends_of(source: object, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return sorted coordinates just before and at a seam."""
    moments = []
    for moment in (time - 1e-5, time):
        source.update(None, {"time": moment})  # type: ignore[attr-defined]
        rows = source.data.rows[source.data.rows[:, 3] > 0.05]  # type: ignore[attr-defined]
        moments.append(np.sort(rows[:, :3], axis=0))
    return moments[0], moments[1]


@pytest.mark.parametrize("engine", ["processes", pytest.param("dask", marks=pytest.mark.slow)])
def test_a_stopped_export_resumes_to_the_same_bytes(
    written: dict[str, bytes], tmp_path: Path, engine: str
) -> None:
    write_sequence(tmp_path / "frames", rows=ROWS, frames=FRAMES)
    last = tmp_path / "frames" / "0008.ply"
    content = last.read_bytes()
    last.write_bytes(content[:500])
    arguments = ("export", "sequence", str(tmp_path / "frames"), "-o", str(tmp_path / "clip.json"))
    ran = gsgen_here(*arguments, *OPTIONS, "--loop")
    assert ran.code == 4
    assert "0008.ply" in ran.err
    assert not (tmp_path / "clip.json").exists()
    (finished,) = (tmp_path / "clip").rglob("0001.onnx")
    times = finished.stat().st_mtime_ns
    last.write_bytes(content)
    assert export(tmp_path, *OPTIONS, "--loop", "--engine", engine, "--workers", "1") == written
    assert (tmp_path / "clip" / "0001.onnx").stat().st_mtime_ns == times


def test_frames_that_share_no_gaussians_are_shown_one_by_one(tmp_path: Path) -> None:
    """Each has a set of its own, of its own size; none is blended with another."""
    rng = np.random.default_rng(0)
    (tmp_path / "frames").mkdir()
    frames = [random_splats(rng, count) for count in (60, 40, 50, 55, 45, 58)]
    for number, splats in enumerate(frames):
        write_ply(tmp_path / "frames" / f"{number}.ply", splats)
    folder = str(tmp_path / "frames")
    ran = gsgen_here("export", "sequence", folder, "-o", str(tmp_path / "clip.onnx"))
    assert ran.code == 1
    assert "too few match" in ran.err
    assert "-o clip.json" in ran.err
    written = export(tmp_path, *OPTIONS)
    assert sum(name.endswith(".sog") for name in written) == len(frames)
    (source,) = open_scene(tmp_path / "clip.json")
    try:
        for number, part in ((0, 0.0), (3, 0.5), (5, 0.99), (1, 0.3)):
            source.update(None, {"time": (number + part) / FPS})
            rows = source.data.rows[: source.count]
            assert len(rows) == len(frames[number].position)
            assert nearest(rows, frames[number].position) < 1e-3
    finally:
        source.close()


def random_splats(rng: np.random.Generator, count: int) -> Splats:
    return Splats(
        position=rng.normal(size=(count, 3)).astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        log_scale=rng.normal(-4, 0.5, (count, 3)).astype(np.float32),
        logit_opacity=np.full(count, 2, np.float32),
        sh=rng.normal(size=(count, 1, 3)).astype(np.float32),
    )


@pytest.mark.usefixtures("written")
def test_a_segment_above_the_capacity_is_named(folder: Path) -> None:
    document = json.loads((folder / "clip.json").read_text())
    document["models"][0]["capacity"] = ROWS - 1
    (folder / "small.json").write_text(json.dumps(document))
    with pytest.raises(SceneInvalid, match=r"0000\.sog: has 300 Gaussians, expected at most 299"):
        open_scene(folder / "small.json")


def test_sound_and_the_upward_axis_are_written_and_the_scene_file_is_checked(folder: Path) -> None:
    with wave.open(str(folder / "speech.wav"), "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        file.writeframes(bytes(4 * 8000))
    (folder / "speech.vtt").write_text("WEBVTT\n\n00:00.000 --> 00:00.800\nIt bends.\n")
    scene, copies = folder / "spoken.json", folder / "spoken"
    files = {"--sound": folder / "speech.wav", "--captions": folder / "speech.vtt"}
    for left_out, message in (("--sound", "--captions: is without --sound"), ("", "is no file")):
        given = {option: file for option, file in files.items() if option != left_out}
        given |= {} if left_out else {"--captions": folder / "none.vtt"}
        words = [str(word) for pair in given.items() for word in pair]
        ran = gsgen_here("export", "sequence", str(folder / "frames"), "-o", str(scene), *words)
        assert (ran.code, copies.exists()) == (2, False)
        assert message in ran.err
    words = [str(word) for pair in files.items() for word in pair]
    (folder / "mine").mkdir()
    for name in ("speech.wav", "speech.vtt"):
        other = folder / "mine" / name
        other.write_bytes(b"kept")
        ran = gsgen_here(
            "export", "sequence", str(folder / "frames"), "-o", str(folder / "mine.json"), *words
        )
        assert ran.code == 2
        assert f"has the name of {other}, which its copy would replace" in ran.err
        assert [file.read_bytes() for file in (folder / "mine").iterdir()] == [b"kept"]
        other.unlink()
    (folder / "mine" / "speech.wav").write_bytes(b"other captions")
    same_name = ["--sound", words[1], "--captions", str(folder / "mine" / "speech.wav")]
    ran = gsgen_here("export", "sequence", str(folder / "frames"), "-o", str(scene), *same_name)
    assert (ran.code, copies.exists()) == (2, False)
    assert "has the name of" in ran.err
    ran = gsgen_here(
        "export",
        "sequence",
        str(folder / "frames"),
        "-o",
        str(scene),
        *OPTIONS,
        *words,
        *("--up", "+y"),
    )
    assert ran.code == 0, ran.err
    document = json.loads(scene.read_text())
    assert document["up"] == "+y"
    assert open_source(copies / "0001.onnx").up == (0, 1, 0)
    sound = document["sound"]
    assert sound == {"path": "spoken/speech.wav", "captions": "spoken/speech.vtt"}
    assert _is_exported("speech.wav", scene)
    assert (copies / "speech.wav").read_bytes() == (folder / "speech.wav").read_bytes()
    assert (copies / "speech.vtt").read_bytes() == (folder / "speech.vtt").read_bytes()
    assert "GC007" in ran.out  # the recording lasts 2 seconds, the frames 0.9
    assert "ends at 2 s" in ran.out


@pytest.mark.parametrize(
    ("option", "value"), [("--segment", "0.5"), ("--engine", "serial"), ("--workers", "2")]
)
def test_options_of_segments_need_a_scene_file(folder: Path, option: str, value: str) -> None:
    model = folder / "one.onnx"
    ran = gsgen_here(
        *("export", "sequence", str(folder / "frames"), "-o", str(model)), option, value
    )
    assert ran.code == 2
    assert f"{option}: {value} is for a scene file of segments, not one.onnx" in ran.err
    assert "one.json" in ran.err
    assert not model.exists()


def test_too_few_frames_are_refused(tmp_path: Path) -> None:
    write_sequence(tmp_path / "frames", rows=50, frames=2)
    scene = tmp_path / "clip.json"
    ran = gsgen_here("export", "sequence", str(tmp_path / "frames"), "-o", str(scene))
    assert ran.code == 2
    assert "has 2 frames, expected three or more for segments" in ran.err
    assert not scene.exists()


def test_a_folder_with_files_of_others_is_refused(tmp_path: Path) -> None:
    """Frames that are named like segments are neither replaced nor removed, nor is any other file."""
    frames = tmp_path / "clip"
    frames.mkdir()
    rng = np.random.default_rng(0)
    for number in range(3):
        write_sog(frames / f"{number:04}.sog", random_splats(rng, 20))
    other = tmp_path / "other"
    other.mkdir()
    (other / "0007.sog").write_bytes(b"kept")
    before = {file: file.read_bytes() for file in tmp_path.rglob("*.sog")}
    for name, place in (("clip", frames), ("other", other / "0007.sog")):
        scene = tmp_path / f"{name}.json"
        ran = gsgen_here("export", "sequence", str(frames), "-o", str(scene), *OPTIONS)
        assert ran.code == 2
        assert str(place) in ran.err
        assert "expected a folder for" in ran.err
        assert not scene.exists()
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before


def test_an_export_replaces_its_own_segments(tmp_path: Path) -> None:
    write_sequence(tmp_path / "frames", rows=20, frames=4)
    export(tmp_path, *OPTIONS[:2], "--segment", "0.1", *OPTIONS[4:])
    (tmp_path / "clip" / "notes.txt").write_text("kept")
    # A stopped export leaves the scene file and its segments as they are.
    last = tmp_path / "frames" / "0003.ply"
    content, before = last.read_bytes(), contents(tmp_path)
    last.write_bytes(content[:500])
    arguments = ("export", "sequence", str(tmp_path / "frames"), "-o", str(tmp_path / "clip.json"))
    assert gsgen_here(*arguments, *OPTIONS, "--segment", "0.2").code == 4
    assert contents(tmp_path) == before
    # Nor is a finished segment of other options taken.
    last.write_bytes(content)
    written = export(tmp_path, *OPTIONS)
    assert set(written) == {"clip.json", "0000.sog", "0001.onnx", "notes.txt"}


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="there are no alarms")
def test_a_clip_out_of_time_ends_at_its_segment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is not validated segment by segment without a limit; the next export resumes with it."""
    write_sequence(tmp_path / "frames", rows=20, frames=FRAMES)
    validate, levels = validator.validate, []

    def validate_late(path: Path, settings: Settings, **options: Any) -> Report:
        levels.append(settings.level)
        if len(levels) == 1:
            signal.raise_signal(signal.SIGALRM)
        return validate(path, settings, **options)

    monkeypatch.setattr(validator, "validate", validate_late)
    scene = tmp_path / "clip.json"
    arguments = ("export", "sequence", str(tmp_path / "frames"), "-o", str(scene), *OPTIONS)
    ran = gsgen_here(*arguments, "--timeout", "600")
    assert ran.code == 1
    assert "out of time after 600 s (--timeout)" in ran.err
    assert ran.err.endswith(f"{scene} was not written\n")
    assert len(levels) == 2  # in time, and what a model out of time needs
    assert not scene.exists()
    assert "clip.json" in export(tmp_path, *OPTIONS)
