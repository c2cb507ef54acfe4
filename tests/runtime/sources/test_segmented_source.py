"""Segments at their seams, and those that cannot be opened or are no Gaussians."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import write_ply
from gsgen.formats.shared.splats import Splats
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.segmented_source import Segment, SegmentedSource
from gsgen.runtime.sources.source import Source

SECONDS = 1.0


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Three files of one, two and three Gaussians."""
    paths = [tmp_path / f"{number}.ply" for number in range(3)]
    for number, path in enumerate(paths):
        write_ply(path, splats(number + 1))
    return paths


def splats(count: int) -> Splats:
    return Splats(
        position=np.zeros((count, 3), np.float32),
        rotation=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scale=np.zeros((count, 3), np.float32),
        logit_opacity=np.zeros(count, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )


def segmented(
    files: list[Path], open_file: Callable[[Path], Source] = open_source
) -> SegmentedSource:
    return SegmentedSource("clip", [Segment(file, SECONDS) for file in files], 3, open_file)


def shown(source: SegmentedSource, time: float) -> int:
    """Return how many Gaussians a moment has."""
    source.update(None, {"time": time})
    return source.data.count


def test_a_moment_at_the_end_of_a_segment_is_the_next_one(files: list[Path]) -> None:
    source = segmented(files)
    moments = [(0.0, 1), (1.0, 2), (np.nextafter(1, 0), 1), (2.0, 3), (3.0, 3), (9.0, 3), (-1.0, 1)]
    assert [shown(source, time) for time, _ in moments] == [count for _, count in moments]
    source.close()


def test_a_file_that_was_missing_before_its_time_is_tried_again(files: list[Path]) -> None:
    content = files[1].read_bytes()
    files[1].unlink()
    source = segmented(files)
    source._opened[1].exception()  # it was opened in vain
    files[1].write_bytes(content)
    assert shown(source, 1) == 2
    files[2].unlink()
    source.update(None, {"time": 0})
    with pytest.raises(SceneUnreadable, match=r"2\.ply"):
        source.start(None, {"time": 2})
    assert source.ready
    source.abandon()
    assert shown(source, 1) == 2
    source.close()


def test_a_mesh_among_segments_is_refused(files: list[Path]) -> None:
    wall = files[1].with_suffix(".obj")
    wall.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    source = segmented([files[0], wall])
    with pytest.raises(SceneInvalid, match=r"1\.obj: is a tileset or has a mesh"):
        shown(source, 1)
    source.close()
    with pytest.raises(SceneInvalid, match=r"1\.obj: is a tileset or has a mesh"):
        segmented([wall, files[0]])
