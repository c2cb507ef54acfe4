"""Streaming: what prefetching gains on journeys, and what arriving tiles cost a frame.

    python -m pytest tests/bench/tiles/bench_streaming.py -o python_files='bench_*.py' \
        -o python_functions='bench_*' -s -q

Journeys go through a generated town, over networks of constant and of changing rate; the table
compares the reactive client, prediction by constant velocity, and a client that knows the path.
Recordings of people take the place of journeys where ``GSGEN_BENCH_RECORDINGS`` names a folder of
checkouts: see ``support.tiles.recordings``.
"""

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.tiles.loading.tileset_loader import open_tileset
from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.prefetch import ViewSettings
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.simulate.client import PREFETCH_POLICIES, simulate
from gsgen.tiles.simulate.tables import read_path, read_trace
from support.tiles.journeys import (
    PATH_HEADER,
    TRACE_HEADER,
    journeys,
    networks,
    write_rows,
    write_town,
)
from support.tiles.recordings import recordings

ARRIVALS_BAR = 1.1  # times a steady frame
KNOWN_PATH_WASTE_BAR = 0.03
RECORDINGS = os.environ.get("GSGEN_BENCH_RECORDINGS")
_TOWN_SCALE = 8.0  # metres of the town for each metre of a room


def _paths(folder: Path) -> Iterator[tuple[str, list[Pose]]]:
    """Yield recordings, from their middle at eye level in the town; else journeys by formula."""
    if not RECORDINGS:
        for name, rows in journeys().items():
            yield name, read_path(write_rows(folder / "path.csv", PATH_HEADER, rows))
        return
    paths = recordings(Path(RECORDINGS))
    assert paths, f"no recording below {RECORDINGS}"
    for name, path in paths.items():
        middle = np.mean([pose.position for pose in path], axis=0)
        eye = np.array([0, 0, 1.7])
        moved = [(pose.position - middle) * _TOWN_SCALE + eye for pose in path]
        yield name, [replace(pose, position=p) for pose, p in zip(path, moved, strict=True)]


@pytest.mark.parametrize("connections", [1, 6])
def bench_journeys(tmp_path: Path, connections: int) -> None:
    tree = TileTree.of_tileset(open_tileset(write_town(tmp_path)))
    print(f"\n{len(tree)} tiles, {connections} connections: reactive, predictive, oracle")
    known_path_waste, mean_hits = [], np.zeros(3)
    for journey, path in _paths(tmp_path):
        for network, rates in networks().items():
            trace = read_trace(write_rows(tmp_path / "trace.csv", TRACE_HEADER, rates))
            results = [
                simulate(
                    tree,
                    path,
                    trace,
                    policy=policy,
                    view=ViewSettings(width=320, height=180),
                    connections=connections,
                ).metrics
                for policy in PREFETCH_POLICIES
            ]
            known_path_waste.append(results[2].waste)
            mean_hits += [entry.hit_rate for entry in results]
            hit_rates = " ".join(f"{entry.hit_rate:6.1%}" for entry in results)
            waste = " ".join(f"{entry.waste:5.1%}" for entry in results)
            delay = " ".join(f"{entry.p95_delay_s:6.2f}" for entry in results)
            hole_count = " ".join(f"{entry.hole_frames:3}" for entry in results)
            print(
                f"{journey:8} {network:7} hits {hit_rates}  waste {waste}  p95 {delay} s  holes {hole_count}"
            )

    print(
        f"known path: waste {np.mean(known_path_waste):.1%} on average, {max(known_path_waste):.1%} "
        f"at most (bar {KNOWN_PATH_WASTE_BAR:.0%} on average); "
        f"hits on average {', '.join(f'{hits / len(known_path_waste):.1%}' for hits in mean_hits)}"
    )
    assert np.mean(known_path_waste) <= KNOWN_PATH_WASTE_BAR


def bench_frames_with_arrivals() -> None:
    """Frames into which tiles arrive beside frames of the same pool without, taken in turn."""
    from gsgen.runtime.renderer.renderer import Renderer
    from gsgen.runtime.scene.camera import Camera
    from gsgen.runtime.scene.scene import Scene
    from gsgen.runtime.scene.splat_pool import SplatPool
    from support.rendering.splat_scenes import cloud

    rows_of_tile, tiles = 8192, 48
    pool = SplatPool((tiles + 8) * rows_of_tile, 48)
    data = [cloud(rows_of_tile, seed, degree=3) for seed in range(tiles + 8)]

    def arrive(tile: int) -> None:
        pool.insert(tile, data[tile].rows, data[tile].appearance, np.zeros(3))

    for tile in range(tiles):
        arrive(tile)
    camera = Camera(np.eye(4), width=640, height=360, fx=500.0, fy=500.0, cx=320.0, cy=180.0)
    renderer, scene = Renderer(rasteriser="tiles"), Scene([], pools=[pool])
    seconds_by_kind: dict[str, list[float]] = {"steady": [], "arrivals": []}
    newest = tiles - 1
    for number in range(44):
        kind = "arrivals" if number % 2 else "steady"
        start = time.process_time()
        if kind == "arrivals":  # two tiles of 1.9 MB: the upload budget of a frame
            for _ in range(2):
                pool.evict(pool.tiles[number % len(pool.tiles)])
                newest = (newest + 1) % len(data)
                while newest in pool.tiles:
                    newest = (newest + 1) % len(data)
                arrive(newest)
        pool.draw(dict.fromkeys(pool.tiles, 1.0))
        renderer.render(scene, camera)
        if number >= 4:
            seconds_by_kind[kind].append(time.process_time() - start)
    steady_seconds, arrivals = (
        float(np.median(seconds_by_kind[kind])) for kind in ("steady", "arrivals")
    )
    print(
        f"\n{tiles} tiles of {rows_of_tile:,} splats at 640×360: steady {1e3 * steady_seconds:.0f} CPU-ms, "
        f"with arrivals {1e3 * arrivals:.0f} ({arrivals / steady_seconds:.3f}; bar {ARRIVALS_BAR})"
    )
    assert arrivals <= ARRIVALS_BAR * steady_seconds
