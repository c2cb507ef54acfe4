"""Whole builds: counts, boxes, errors, identical bytes, stopped and killed builds."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import write_ply
from gsgen.tiles.build.build import WORK_FOLDER, _sole_build, build_tileset
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.progress import SilentProgress
from gsgen.tiles.format.tileset import Tile
from gsgen.tiles.format.volumes import Box
from gsgen.tiles.loading.leaves import read_leaves
from gsgen.tiles.loading.tileset_loader import open_tileset
from support.commands import gsgen_here
from support.tiles.builds import CHUNK, PARTITION, SMALL, build
from support.tiles.tile_scenes import digests, scattered


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.ply"
    write_ply(path, scattered(40_000))
    return path


@pytest.fixture(scope="module")
def town(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("town") / "tiles"
    build([scene], output)
    return output


def test_leaves_hold_every_splat_once(scene, town):
    leaves = read_leaves(town / "tileset.json")
    expected = scattered(40_000)
    assert len(leaves) == len(expected)
    tileset = open_tileset(town / "tileset.json")
    assert tileset.metadata["source_splats"] == 40_000
    # Positions are within a step of the codec; match them in order of x, y and z.
    order = np.lexsort(np.round(leaves.position, 1).T)
    order_expected = np.lexsort(np.round(expected.position, 1).T)
    np.testing.assert_allclose(
        np.sort(leaves.position, axis=0), np.sort(expected.position, axis=0), atol=0.01
    )
    assert len(order) == len(order_expected)


def corners(box: Box) -> tuple[np.ndarray, np.ndarray]:
    half = np.abs(box.half_axes).sum(axis=0)
    return box.center - half, box.center + half


def max_cell(tile: Tile) -> float:
    return max(tile.metadata["cell"], *(max_cell(child) for child in tile.children), 0)


def test_boxes_contain_children_and_errors_grow_upwards(town):
    tileset = open_tileset(town / "tileset.json")
    pairs = list(tileset.pairs())
    assert len(pairs) > 50
    for above, child_box in pairs:
        (low, high), (low_below, high_below) = corners(above.volume), corners(child_box.volume)
        tolerance = 1e-6 * np.abs(high - low).max()
        assert (low <= low_below + tolerance).all()
        assert (high_below <= high + tolerance).all()
        assert above.geometric_error >= child_box.geometric_error
    for tile in tileset.tiles():
        assert (tile.geometric_error == 0) == (not tile.children)
        if tile.children:
            # Members of a cell of side h are h √3 / 2 from their mean at most, as a root of squares.
            assert 0 < tile.geometric_error < 11.1 * max_cell(tile)
            assert tile.metadata["error"][0] >= np.float32(tile.geometric_error)
            assert tile.metadata["splats"] <= 2 * SMALL.leaf
        else:
            assert tile.metadata["splats"] <= SMALL.leaf


def test_large_splats_are_in_leaves_of_large_tiles(town):
    """No leaf but the root's own is far smaller than a splat in it."""
    expected = scattered(40_000)
    reach = 3 * np.exp(expected.log_scale.max(axis=1))
    assert reach.max() > 20
    tileset = open_tileset(town / "tileset.json")
    sizes = [tile.volume.size for tile in tileset.tiles() if not tile.children]
    assert np.median(sizes) < 0.2 * max(sizes)


def test_build_record_has_source_count_and_digests(town):
    document = json.loads((town / "tileset.json").read_text())
    transform = document["root"]["transform"]
    assert transform == [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]
    record = json.loads((town / "gsgen.tiles.json").read_text())
    assert record["source_splats"] == 40_000
    actual = digests(town)
    actual.pop("gsgen.tiles.json")
    assert actual == {name: entry["sha256"] for name, entry in record["files"].items()}
    assert not (town / WORK_FOLDER).exists()


@pytest.mark.parametrize("engine", ["processes", "dask"])
def test_every_engine_gives_the_same_bytes(scene, town, tmp_path, engine):
    if engine == "dask":
        pytest.importorskip("distributed")
    build([scene], tmp_path / "tiles", engine=engine)
    assert digests(tmp_path / "tiles") == digests(town)


@pytest.mark.parametrize("partition", [700, 15_000, 10**6])
def test_chunks_and_partitions_change_no_byte(scene, town, tmp_path, partition):
    with open_engine("serial") as engine:
        build_tileset(
            [scene],
            tmp_path / "a",
            SMALL,
            engine=engine,
            progress=SilentProgress(),
            partition=partition,
        )
    assert digests(tmp_path / "a") == digests(town)


def test_a_build_in_another_folder_of_a_copied_scene_is_the_same(scene, town, tmp_path):
    shutil.copy(scene, tmp_path / "copy.ply")
    os.utime(tmp_path / "copy.ply", (1, 1))
    build([tmp_path / "copy.ply"], tmp_path / "deep" / "er")
    assert digests(tmp_path / "deep" / "er") == digests(town)


class Stop(Exception):
    """Stops a build in the middle."""


class Stopper(SilentProgress):
    """Stops after so many tasks."""

    def __init__(self, tasks: int) -> None:
        self.tasks = tasks

    def advance(self, splats: int) -> None:
        self.tasks -= 1
        if self.tasks < 0:
            raise Stop


def test_a_stopped_build_goes_on_and_gives_the_same_bytes(scene, town, tmp_path):
    output, stops = tmp_path / "tiles", 0
    for tasks in (1, 4, 8, 10, 14, 20, 1000):
        stopper = Stopper(tasks)
        try:
            with open_engine("serial") as engine:
                build_tileset(
                    [scene],
                    output,
                    SMALL,
                    engine=engine,
                    progress=stopper,
                    chunk_bytes=CHUNK,
                    partition=PARTITION,
                )
        except Stop:
            stops += 1
            assert (output / WORK_FOLDER).is_dir()
            assert not (output / "gsgen.tiles.json").exists()
            draft = output / "t" / ".gsgen-00112233445566ff.part"
            draft.mkdir(parents=True)
            (draft / "draft").write_bytes(b"of a killed worker")
    assert stops >= 4
    assert digests(output) == digests(town)


def _children(process: int) -> list[int]:
    lists = Path(f"/proc/{process}/task").glob("*/children")  # each thread has its own
    return [int(word) for path in lists for word in path.read_text().split()]


_SCRIPT = """
import sys
from pathlib import Path
from gsgen.tiles.build.build import build_tileset
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.frame import upright_transform
from gsgen.tiles.build.parameters import BuildParameters
from gsgen.tiles.build.progress import JsonProgress

if __name__ == "__main__":
    parameters = BuildParameters(leaf=700, qualities=(0,), implicit=False, transform=upright_transform())
    with open_engine(sys.argv[3], 2) as engine:
        build_tileset([Path(sys.argv[1])], Path(sys.argv[2]), parameters, engine=engine,
                      progress=JsonProgress(lambda line: print(line, flush=True)),
                      chunk_bytes=1 << 20, partition=4000)
"""


def _started(tmp_path: Path, scene: Path, engine: str) -> "subprocess.Popen[str]":
    (tmp_path / "run.py").write_text(_SCRIPT)
    return subprocess.Popen(
        [sys.executable, str(tmp_path / "run.py"), str(scene), str(tmp_path / "tiles"), engine],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _wait_for(folder: Path, pattern: str, count: int, process: "subprocess.Popen[str]") -> None:
    end = time.monotonic() + 100
    while len(list(folder.glob(pattern))) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.mark.parametrize("engine", ["serial", "processes"])
def test_a_build_that_was_killed_goes_on(scene, town, tmp_path, engine):
    with _started(tmp_path, scene, engine) as process:
        _wait_for(tmp_path / "tiles", f"{WORK_FOLDER}/*/tiles/*.json", 3, process)
        process.kill()
    assert not (tmp_path / "tiles" / "gsgen.tiles.json").exists()
    build([scene], tmp_path / "tiles")
    assert digests(tmp_path / "tiles") == digests(town)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="workers are found in /proc")
@pytest.mark.parametrize("engine", ["processes", "dask"])
def test_a_killed_worker_changes_no_byte(scene, town, tmp_path, engine):
    if engine == "dask":
        pytest.importorskip("distributed")
    with _started(tmp_path, scene, engine) as process:
        _wait_for(tmp_path / "tiles", f"{WORK_FOLDER}/*/tiles/*.json", 2, process)
        killed = 0
        for child in _children(process.pid):
            command = Path(f"/proc/{child}/cmdline").read_bytes()
            if b"spawn_main" in command and not killed:
                os.kill(child, signal.SIGKILL)
                killed += 1
        err = process.communicate(timeout=200)[1]
    assert killed == 1
    assert process.returncode == 0, err
    assert digests(tmp_path / "tiles") == digests(town)


def test_two_builds_in_one_folder_are_refused_in_one_line(scene, tmp_path):
    """The second names the process that builds; once that has ended, it builds."""
    command = ("tiles", "build", scene, "-o", tmp_path / "tiles", "--engine", "serial")
    with _sole_build(tmp_path / "tiles"):
        completed = gsgen_here(*command)
    assert (completed.code, completed.out) == (2, "")
    expected = f"{tmp_path / 'tiles'}: process {os.getpid()} is building a tileset in this folder"
    assert expected in completed.err
    assert "Traceback" not in completed.err
    assert gsgen_here(*command).code == 0
    assert not (tmp_path / "tiles" / WORK_FOLDER).exists()


def test_a_second_build_has_nothing_to_do(scene, tmp_path):
    first = build([scene], tmp_path / "tiles")
    times = {path: path.stat().st_mtime_ns for path in (tmp_path / "tiles").rglob("*.glb")}
    second = build([scene], tmp_path / "tiles")
    assert second.up_to_date
    assert (second.key, second.splats, second.bytes) == (first.key, 40_000, first.bytes)
    assert times == {p: p.stat().st_mtime_ns for p in (tmp_path / "tiles").rglob("*.glb")}
    next(iter(times)).unlink()
    assert not build([scene], tmp_path / "tiles").up_to_date
    assert len(list((tmp_path / "tiles").rglob("*.glb"))) == len(times)


def test_another_build_replaces_the_first_and_leaves_no_stale_file(scene, town, tmp_path):
    other = replace(SMALL, leaf=2000, qualities=(0, 2, 4))
    build([scene], tmp_path / "tiles", other)
    assert len(list((tmp_path / "tiles").glob("tileset*.json"))) == 4
    build([scene], tmp_path / "tiles")
    assert digests(tmp_path / "tiles") == digests(town)


def test_fresh_build_ignores_earlier_work(scene, town, tmp_path):
    (tmp_path / "tiles" / WORK_FOLDER / "old").mkdir(parents=True)
    report = build([scene], tmp_path / "tiles", fresh=True)
    assert not report.up_to_date
    assert not build([scene], tmp_path / "tiles", fresh=True).up_to_date
    assert digests(tmp_path / "tiles") == digests(town)


def test_qualities_have_the_same_tree_and_fewer_bytes(scene, tmp_path):
    build([scene], tmp_path / "tiles", replace(SMALL, qualities=(0, 2, 4)))
    sizes = []
    for quality in (0, 2, 4):
        tileset = open_tileset(tmp_path / "tiles" / f"tileset-q{quality}.json")
        sizes.append(
            sum(
                (tmp_path / "tiles" / content.uri).stat().st_size
                for tile in tileset.tiles()
                for content in tile.contents
            )
        )
        assert len(read_leaves(tmp_path / "tiles" / f"tileset-q{quality}.json")) == 40_000
    assert sizes[0] > sizes[1] > sizes[2]


@pytest.mark.parametrize("codec", ["spz", "khr"])
def test_an_implicit_octree_has_all_splats(scene, tmp_path, codec):
    build([scene], tmp_path / "tiles", replace(SMALL, implicit=True, codec=codec))
    tileset = open_tileset(tmp_path / "tiles" / "tileset.json")
    leaves = read_leaves(tmp_path / "tiles" / "tileset.json")
    assert len(leaves) == 40_000
    finest_tiles = [tile for tile in tileset.tiles() if tile.is_finest and tile.contents]
    assert sum(tile.metadata["splats"] for tile in finest_tiles) == 40_000
    assert all(tile.metadata["splats"] <= SMALL.leaf for tile in finest_tiles)
