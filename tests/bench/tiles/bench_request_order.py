"""The order of requests beside simpler ones: how good are the pictures, how many have holes?

    python -m pytest tests/bench/tiles/bench_request_order.py -o python_files='bench_*.py' \
        -o python_functions='bench_*' -s -q

A town of tiles with three files each is streamed along five journeys over three slow networks, on
a virtual clock. The utility of a frame is the area of the drawn tiles × the worth of their files,
less the worth that their screen-space error costs, as a share of that of the wanted tiles.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsgen.tiles.loading.quality_ladder import QualityLadder
from gsgen.tiles.loading.tileset_loader import open_tileset
from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.prefetch import ViewSettings
from gsgen.tiles.selection.cut import TileCut, cut_tree
from gsgen.tiles.selection.request_order import finer_file_order, missing_tiles, request_order
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.simulate.network import RateTrace, SimulatedLink, VirtualClock
from gsgen.tiles.simulate.tables import read_path
from gsgen.tiles.streaming.drawing import drawable_tiles
from support.tiles.journeys import PATH_HEADER, journeys, write_rows, write_town

ORDERS = ("finest files", "coarsest first", "root alone, then coarsest first")
NETWORKS = (2.0, 5.0, 12.0)  # megabits a second
_HALF_WORTH = 228.0  # pixels of error that halve the worth of a tile
_SHARES = np.array([1.0, 0.69, 0.52])  # bytes of the files at qualities 0, 2 and 4 of a town
_GOOD = 0.9


def utility(
    tree: TileTree,
    ladder: QualityLadder,
    cut: TileCut,
    held_levels: np.ndarray,
    drawn: np.ndarray,
    eye,
) -> float:
    """The worth of the drawn tiles, as a share of that of all wanted tiles at the finest file."""
    reach = np.linalg.norm(tree.half_axes, axis=(1, 2))
    distance = np.linalg.norm(tree.center - eye, axis=1)
    area = np.where(cut.selected, np.minimum(reach / np.maximum(distance, 1e-9), 1) ** 2, 0)
    ideal_area = area.copy()
    for row in range(len(tree) - 1, 0, -1):  # a coarse tile covers what the tiles below it cover
        area[tree.parent[row]] += area[row]
    density = 1 / (1 + np.where(tree.is_leaf, 0, cut.error) / _HALF_WORTH)
    shown = (area * density * ladder.worth[np.arange(len(tree)), held_levels])[drawn].sum()
    return float(shown / (ideal_area * density)[cut.selected].sum() / ladder.worth[0, 0])


def stream(
    tree: TileTree, ladder: QualityLadder, path: Sequence[Pose], mbps: float, order: str
) -> tuple[list[float], int]:
    """Stream a town; return the utility of each frame, and the number of frames with holes."""
    clock = VirtualClock(path[0].time)
    trace = RateTrace(np.array([0.0]), np.array([mbps * 125_000]))
    size = tree.size.astype(float)
    link = SimulatedLink(clock, trace, size, rtt=0.05, connections=6)
    view = ViewSettings(width=640, height=360)
    held_levels, in_flight = np.full(len(tree), -1), {}
    utilities, hole_count = [], 0
    first_quality = 0 if order == "finest files" else ladder.size.shape[1] - 1

    def request(cut: TileCut, drawn: np.ndarray, eye: np.ndarray) -> None:
        loaded = held_levels >= 0
        actual = request_order(tree, cut)
        missing = actual[~loaded[actual]]
        if order == ORDERS[2]:
            missing = missing_tiles(actual, loaded)
        pairs = [(int(tile), first_quality) for tile in missing]
        if not len(missing):
            pairs = [
                (int(tile), 0) for tile in finer_file_order(tree, ladder, held_levels, drawn, eye)
            ]
        for tile, quality in pairs:
            if link.free_request_count and tile not in in_flight:
                size[tile] = ladder.size[tile, quality]
                in_flight[tile] = quality
                link.request(tile)

    cut = drawn = pose = None
    for pose in path:
        while (delivered := link.advance(pose.time)) is not None:
            held_levels[delivered.tile] = in_flight.pop(delivered.tile)
            if cut is not None:
                request(cut, drawn, pose.position)
        cut = cut_tree(tree, view.frustum(pose.position, pose.quaternion), 8.0)
        if not cut.selected.any():
            continue
        drawn = drawable_tiles(tree, cut, held_levels >= 0)
        covered = drawn.copy()
        for rows in tree.rows_of_level[1:]:
            covered[rows] |= covered[tree.parent[rows]]
        good_share = drawn.copy()
        for row in range(len(tree) - 1, 0, -1):
            good_share[tree.parent[row]] |= good_share[row]
        hole_count += bool((cut.selected & ~covered & ~good_share).any())
        utilities.append(utility(tree, ladder, cut, held_levels, drawn, pose.position))
        request(cut, drawn, pose.position)
    return utilities, hole_count


def bench_request_order(tmp_path: Path) -> None:
    tree = TileTree.of_tileset(open_tileset(write_town(tmp_path)))
    sizes = tree.size[:, None] * _SHARES
    worth = np.tile([0.9997, 0.9844, 0.9661], (len(tree), 1))
    ladder = QualityLadder(files=(), size=sizes, worth=worth)
    print(f"\n{len(tree)} tiles: mean utility, frames below {_GOOD}, frames with holes")
    mean_worths = {}
    for order in ORDERS:
        frames, hole_count = [], []
        for rows in journeys().values():
            path = read_path(write_rows(tmp_path / "path.csv", PATH_HEADER, rows))
            for mbps in NETWORKS:
                values, count = stream(tree, ladder, path, mbps, order)
                frames += values
                hole_count.append(count)
        mean_worths[order] = np.mean(frames), np.mean(hole_count)
        good_share = np.mean(np.array(frames) < _GOOD)
        print(f"{order:32} {np.mean(frames):.3f}  {good_share:.3f}  {np.mean(hole_count):.1f}")
    finest_mean, coarsest, alone = (mean_worths[order] for order in ORDERS)
    assert coarsest[0] > finest_mean[0]
    assert alone[1] <= coarsest[1]
