"""`tiles build --codec sog`: one set of files, whatever divides the work, with errors by leaf."""

import json
import math
import multiprocessing
import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.formats import Splats, open_splats, write_ply
from gsgen.formats.merging.levels import geometric_error
from gsgen.formats.shared.splat_values import linear_scale
from gsgen.tiles.build import build as building
from gsgen.tiles.build import streamed_sog
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.plan import octree_runs
from gsgen.tiles.build.progress import SilentProgress
from gsgen.tiles.loading.tileset_loader import open_tileset
from support.commands import gsgen_here
from support.tiles.builds import SMALL, build
from support.tiles.tile_scenes import digests, scattered

SPLATS = 6_000
STREAMED = replace(SMALL, is_streamed_sog=True)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.ply"
    write_ply(path, scattered(SPLATS))
    return path


@pytest.fixture(scope="module", autouse=True)
def small_units() -> Iterator[None]:
    """Units of 1,500 splats, so that a small scene has several."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (building, streamed_sog):
            patch.setattr(module, "UNIT_SPLATS", 1500)
        yield


@pytest.fixture(scope="module")
def town(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("town") / "sog"
    build([scene], output, STREAMED)  # partitions of 4,000 splats
    return output


def test_no_byte_depends_on_the_division_of_the_work(
    scene: Path, town: Path, tmp_path: Path
) -> None:
    with open_engine("serial", 1) as engine:
        for output, is_there in ((tmp_path / "whole", False), (town, True)):
            report = building.build_tileset(
                [scene], output, STREAMED, engine=engine, progress=SilentProgress()
            )
            assert report.up_to_date == is_there
    assert digests(town) == digests(tmp_path / "whole")
    assert len(list(town.glob("0_*"))) > 3
    # A tileset in the same folder takes its place, and nothing of it stays.
    build([scene], tmp_path / "whole")
    assert not list((tmp_path / "whole").glob("*_*"))
    assert not (tmp_path / "whole" / "lod-meta.json").exists()


class Killer(SilentProgress):
    """Ends the process like a fault of the machine, once so many tasks have been counted."""

    def __init__(self, tasks: float) -> None:
        self.tasks = tasks

    def advance(self, splats: int) -> None:
        self.tasks -= 1
        if self.tasks <= 0:
            os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a child with the small units is killed")
def test_a_build_that_was_killed_three_times_gives_the_same_bytes(
    scene: Path, town: Path, tmp_path: Path
) -> None:
    def build_until(tasks: float) -> None:
        with open_engine("serial", 1) as engine:
            building.build_tileset(
                [scene], tmp_path / "sog", STREAMED, engine=engine, progress=Killer(tasks),
                chunk_bytes=1 << 17, partition=1500,
            )  # fmt: skip

    counts = []
    for tasks in (2, 5, 7, math.inf):
        child = multiprocessing.get_context("fork").Process(target=build_until, args=(tasks,))
        child.start()
        child.join()
        is_killed = child.exitcode == -signal.SIGKILL
        assert is_killed is (tasks < math.inf)
        assert (tmp_path / "sog" / "lod-meta.json").exists() is not is_killed
        counts.append(len(list((tmp_path / "sog").glob("0_*"))))
    assert counts == sorted(set(counts)), counts  # nothing, parts, and all
    assert digests(tmp_path / "sog") == digests(town)


def test_every_splat_is_in_one_leaf_at_each_level(town: Path) -> None:
    document = json.loads((town / "lod-meta.json").read_text())
    expected = scattered(SPLATS)
    read = open_splats(town / "lod-meta.json")
    assert isinstance(read, Splats)
    assert document["counts"][0] == len(read) == len(expected)
    np.testing.assert_allclose(
        np.sort(read.position, axis=0), np.sort(expected.position, axis=0), atol=0.02
    )
    leaves = [leaf for unit in document["tree"]["children"] for leaf in unit["children"]]
    for leaf in leaves:
        assert list(leaf["lods"]) == ["0", "1", "2", "3"]
        assert leaf["errors"][0] == 0
        assert leaf["errors"] == sorted(leaf["errors"])
        counts = [rows["count"] for rows in leaf["lods"].values()]
        assert all(0 < b <= max(1, a // 4) for a, b in pairwise(counts))
    # Rows of leaves fill the files without a gap.
    for number in range(len(document["filenames"])):
        rows = [row for leaf in leaves for row in leaf["lods"].values() if row["file"] == number]
        spans = sorted((row["offset"], row["offset"] + row["count"]) for row in rows)
        assert spans[0][0] == 0
        assert all(end == start for (_, end), (start, _) in pairwise(spans))


def test_the_error_is_the_shift_of_the_merged_splats(tmp_path: Path) -> None:
    """Four pairs a distance of 2 d apart become four splats: each has moved by d."""
    offsets = np.array([[-0.05, 0, 0], [0.05, 0, 0]], np.float32)
    corners = np.array([[0, 0, 0], [8, 0, 0], [0, 8, 0], [8, 8, 8]], np.float32)
    positions = np.repeat((corners[:, None] + offsets).reshape(-1, 3), 2, axis=0)
    splats = scattered(len(positions), degree=0)
    splats = replace(
        splats,
        position=positions,
        log_scale=np.full_like(splats.log_scale, -4),
        logit_opacity=np.zeros_like(splats.logit_opacity),
    )
    write_ply(tmp_path / "pairs.ply", splats)
    build([tmp_path / "pairs.ply"], tmp_path / "out", STREAMED)
    root = open_tileset(tmp_path / "out" / "lod-meta.json").root
    (coarsest,) = root.children
    below = coarsest.children[0].children[0]  # level 1: of 16 splats 4 are left
    assert below.metadata["splats"] == 4
    assert below.geometric_error == pytest.approx(geometric_error(0.05**2), rel=0.01)
    assert coarsest.geometric_error > below.geometric_error
    assert linear_scale(splats).max() < 0.05


def test_runs_are_octree_cells_and_groups_of_neighbours() -> None:
    codes = np.sort(np.random.default_rng(3).integers(0, 1 << 63, 900, np.uint64))
    runs = list(octree_runs(codes, 0, 50))
    rows = np.concatenate([np.arange(run.start, run.stop) for run in runs])
    np.testing.assert_array_equal(rows, np.arange(900))
    assert max(run.stop - run.start for run in runs) <= 50
    same = np.zeros(70, np.uint64)
    assert list(octree_runs(same, 0, 50)) == [slice(0, 70)]  # cannot be divided


def test_what_a_streamed_sog_cannot_say_is_refused(scene: Path, tmp_path: Path) -> None:
    write_ply(tmp_path / "linear.ply", replace(scattered(40), color_space="linear"))
    with pytest.raises(ConfigInvalid, match="color_space is linear"):
        build([tmp_path / "linear.ply"], tmp_path / "out", STREAMED)
    output = ("-o", tmp_path / "out", "--codec", "sog")
    result = gsgen_here("tiles", "build", scene, *output, "--lon", "1", "--lat", "2")
    assert result.code == 2
    assert "--lon: cannot be combined with --codec sog" in result.err
    for codec in ("sog", "khr"):
        options = ("-o", tmp_path / "out", "--codec", codec, "--quality", "3")
        result = gsgen_here("tiles", "build", scene, *options)
        assert result.code == 2
        assert f"--quality: cannot be combined with --codec {codec}" in result.err
    result = gsgen_here("tiles", "build", scene, *output, "--engine", "serial")
    assert "6,000 splats in " in result.out
