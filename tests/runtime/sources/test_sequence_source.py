"""Numbered splat files are the frames of a sequence, in the order of their numbers."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import Splats, write_ply, write_splat, write_spz
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.natural_order import natural_key
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.sequence_source import SequenceSource, sequence_files
from gsgen.runtime.sources.source import StillFrameSource

NUMBERS = (1, 2, 3, 9, 10, 11, 20, 100)


def splats(number: int, count: int = 4, degree: int = 0) -> Splats:
    """Gaussians at x = the number of the frame."""
    return Splats(
        position=np.tile(np.float32([number, 0, 0]), (count, 1)),
        rotation=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        log_scale=np.full((count, 3), -2, np.float32),
        logit_opacity=np.full(count, 2, np.float32),
        sh=np.full((count, (degree + 1) ** 2, 3), 0.5, np.float32),
    )


WRITERS = {".ply": write_ply, ".spz": write_spz, ".splat": write_splat}


def write_frames(folder: Path, name: str, numbers: tuple[int, ...] = NUMBERS) -> Path:
    folder.mkdir(exist_ok=True)
    for number in numbers:
        path = folder / (name % number)
        WRITERS[path.suffix](path, splats(number))
    return folder


def test_numbers_in_names_are_ordered_as_numbers() -> None:
    names = ["a10b2", "a2b10", "a2b9", "a", "b1", "a02b1", "10", "9", "1x", "a-3"]
    expected = ["1x", "9", "10", "a", "a02b1", "a2b9", "a2b10", "a10b2", "a-3", "b1"]
    assert sorted(names, key=natural_key) == expected
    rng = np.random.default_rng(0)
    for _ in range(20):
        shuffled = rng.permutation([f"frame_{n}.ply" for n in range(120)]).tolist()
        assert sorted(shuffled, key=natural_key) == [f"frame_{n}.ply" for n in range(120)]


NAMES = ["%d.ply", "f%d.ply", "f%04d.ply", "take2_%d.ply", "frame.%06d.spz", "a-%02d.splat"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("form", ["folder", "pattern"])
def test_a_sequence_is_found_in_the_order_of_numbers(name: str, form: str, tmp_path: Path) -> None:
    folder = write_frames(tmp_path / "seq", name)
    path = folder if form == "folder" else folder / name
    assert sequence_files(path) == [folder / (name % number) for number in NUMBERS]
    source = open_source(path)
    assert isinstance(source, SequenceSource)
    positions = []
    for frame in range(len(NUMBERS)):
        source.update(None, {"frame": frame})
        positions.append(round(float(source.data.rows[0, 0])))
    assert positions == list(NUMBERS)


@pytest.mark.parametrize(
    ("names", "pattern", "expected"),
    [
        (["1.ply"], "", []),  # one file
        (["1.ply", "2.spz"], "", []),  # two kinds
        (["a.ply", "b.ply"], "", []),  # no numbers
        (["1.ply", "2.ply", "notes.txt", ".3.ply"], "", ["1.ply", "2.ply"]),
        (["1.ply", "2.ply"], "%d.ply", ["1.ply", "2.ply"]),
        (["f1.ply", "g2.ply"], "f%d.ply", ["f1.ply"]),
        (["f1.ply", "f0002.ply"], "f%04d.ply", ["f0002.ply"]),
        (["f%d.ply", "f1.ply"], "f%d.ply", []),  # a file of this very name
    ],
)
def test_what_is_a_sequence(
    names: list[str], pattern: str, expected: list[str], tmp_path: Path
) -> None:
    for name in names:
        (tmp_path / name).touch()
    path = tmp_path / pattern if pattern else tmp_path
    assert [file.name for file in sequence_files(path)] == expected


def test_a_pattern_without_files_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SceneUnreadable, match="matches no file"):
        open_source(tmp_path / "%d.ply")


def test_frames_may_differ_in_count_and_degree(tmp_path: Path) -> None:
    for number, (count, degree) in enumerate([(4, 0), (9, 2), (1, 1)]):
        write_ply(tmp_path / f"{number}.ply", splats(number, count, degree))
    source = open_source(tmp_path)
    for number, count in ((1, 9), (2, 1), (0, 4), (1, 9)):
        source.update(None, {"frame": number})
        alone = StillFrameSource(tmp_path / f"{number}.ply").data
        assert source.count == count
        np.testing.assert_array_equal(source.data.rows[:count], alone.rows)
        channels = alone.appearance.shape[1]
        np.testing.assert_array_equal(source.data.appearance[:count, :channels], alone.appearance)
        assert not source.data.appearance[:count, channels:].any()
    with pytest.raises(SceneInvalid, match="the frame is 3, expected 0 to 2"):
        source.update(None, {"frame": 3})


def test_frames_of_two_kinds_are_refused(tmp_path: Path) -> None:
    rows, harmonics = np.zeros((4, 10), np.float32), np.zeros((4, 12), np.float32)
    np.savez(tmp_path / "0.npz", gaussians=rows, appearance=harmonics)
    np.savez(tmp_path / "1.npz", points=rows[:, :3], colors=np.zeros((4, 3), np.uint8))
    with pytest.raises(SceneInvalid, match=r"1\.npz: has rgb, .*expected sh"):
        open_source(tmp_path)


def test_a_film_has_a_frame_for_each_file(tmp_path: Path) -> None:
    folder = write_frames(tmp_path / "seq", "f%d.ply", (1, 2, 10))
    source = open_source(folder)
    view = viewpoint("look-at:5,0,-20,5,0,0", width=60, height=12)
    film = FrameSequence([source], view, renderer=Renderer(rasteriser="tiles"))
    assert film.frames == 3
    columns = [float(film.draw(number).alpha.sum(axis=0).argmax()) for number in range(3)]
    assert columns == sorted(columns)
    assert len(set(columns)) == 3
    assert FrameSequence([source], view, frames=7, renderer=film.player.renderer).frames == 7
