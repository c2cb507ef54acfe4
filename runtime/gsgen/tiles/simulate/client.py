"""Simulates a streaming client: camera frames, deliveries, and the viewer's own planner.

The reactive client is normative. Frames are the rows of the path. At each frame, in order:

1. Deliveries up to its time; at each, a free connection asks again at that instant, by the frame
   before.
2. Seen are the tiles that meet the four side planes and z ≥ 0, from the root down; wanted are
   those of them that are not refined. A tile with children is refined above the largest error.
3. A tile that is wanted now, and was not one frame ago, is an entry: a hit if it is loaded, else
   its delay runs until it is loaded, or to the end.
4. A free connection asks for the seen tile that is not loaded with the least (level, −error,
   index), in depth-first order; as long as the root is missing, for no other.
"""

__all__ = ["PREFETCH_POLICIES", "DrawnMoment", "Simulation", "simulate"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, final

import numpy as np
from jaxtyping import Bool

from gsgen.tiles.loading.quality_ladder import QualityLadder, TileQualities
from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.predictor import ConstantVelocity, Predictor
from gsgen.tiles.prediction.prefetch import HorizonPrefetch, PathPrefetch, Prefetch, ViewSettings
from gsgen.tiles.selection.cut import TileCut, cut_tree
from gsgen.tiles.selection.request_order import finer_file_order
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.simulate.network import RateTrace, SimulatedLink, VirtualClock
from gsgen.tiles.simulate.prediction_error import PredictionError, prediction_error
from gsgen.tiles.streaming.drawing import drawable_tiles
from gsgen.tiles.streaming.metrics import MetricsRecorder, StreamingMetrics
from gsgen.tiles.streaming.planner import RequestPlanner

Policy = Literal["reactive", "predictive", "oracle"]
PREFETCH_POLICIES: Final[tuple[Policy, ...]] = ("reactive", "predictive", "oracle")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnMoment:
    """What a frame of a simulation draws.

    Attributes:
        pose: Of the camera.
        drawn: The tiles, each with its file: 0 is the finest.
        wanted: The tiles once all have come.
    """

    pose: Pose
    drawn: dict[int, int]
    wanted: tuple[int, ...]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation:
    """The result of a streaming simulation.

    Attributes:
        policy: Of the client.
        metrics: Of all frames.
        times: Of the frames, in seconds.
        share_loaded: Share of the wanted tiles that were there, of each frame.
        received: Bytes received up to each frame.
        prediction: How far predicted cameras were from the path; None of other policies.
        moments: What was drawn at the seconds of the path that were asked for.
        ssim: Of the pictures at these seconds, where they were compared.
    """

    policy: Policy
    metrics: StreamingMetrics
    times: tuple[float, ...]
    share_loaded: tuple[float, ...]
    received: tuple[int, ...]
    prediction: PredictionError | None = None
    moments: dict[float, DrawnMoment] = field(default_factory=dict, compare=False)
    ssim: dict[float, float] = field(default_factory=dict)


def simulate(
    tree: TileTree,
    path: Sequence[Pose],
    trace: RateTrace,
    *,
    ladder: QualityLadder | None = None,
    policy: Policy = "reactive",
    predictor: Callable[[], Predictor] = ConstantVelocity,
    view: ViewSettings | None = None,
    rtt: float = 0.05,
    connections: int = 1,
    moments: Sequence[float] = (),
) -> Simulation:
    """Stream a tileset's tiles along a camera path over a simulated network.

    Equal arguments give equal results, bit for bit.

    Args:
        tree: The tiles.
        path: Frames of the camera; times ascend.
        trace: Rate of the network, on the same clock.
        ladder: The files of the tiles at several qualities: the coarsest come first, finer ones
            while nothing seen is missing. None for one file each, of the size that the tree tells.
        policy: ``reactive`` asks for seen tiles, ``predictive`` also for tiles that a predictor
            expects to be seen, ``oracle`` for those that the path itself will see.
        predictor: Makes the predictor of the predictive policy.
        view: Image and error of the client; 1280 × 720, 50°, 16 pixels where absent.
        rtt: Seconds from a request to the first byte.
        connections: How many requests may run at once.
        moments: Seconds from the start of the path; what the next frame draws is kept.
    """
    view = view or ViewSettings()
    clock = VirtualClock(path[0].time)
    qualities = TileQualities(ladder) if ladder else None
    if qualities:
        tree = replace(tree, size=qualities.coarsest_size.copy())
    next_size = tree.size.copy()  # of the file that is requested next
    link = SimulatedLink(clock, trace, next_size, rtt=rtt, connections=connections)
    recorder = MetricsRecorder(tree.parent, tree.size)
    prefetch: Prefetch | None = None
    if policy == "predictive":
        prefetch = HorizonPrefetch(tree, predictor(), view.frustum, view.max_error)
    elif policy == "oracle":
        frustums = [view.frustum(pose) for pose in path]
        times = [pose.time for pose in path]
        prefetch = PathPrefetch(tree, frustums, view.max_error, times=times)
    planner = RequestPlanner(tree, link, recorder, prefetch)
    loaded = np.array([not tile.contents for tile in tree.tiles])
    drawn_shares, received = [], []
    cut: TileCut | None = None
    eye = path[0].position
    shots: dict[float, DrawnMoment] = {}

    def finer_tiles() -> list[int]:
        if qualities is None or cut is None:
            return []
        drawn = cut.selected & loaded
        order = finer_file_order(tree, qualities.ladder, qualities.gpu_quality, drawn, eye)
        return [int(tile) for tile in order]

    for pose in path:
        while (tile_delivery := link.advance(pose.time)) is not None:
            tile = tile_delivery.tile
            loaded[tile] = True
            if qualities:
                quality = qualities.next_quality(tile)
                tree.size[tile] = qualities.size(tile, quality)
                qualities.gpu_quality[tile] = quality
                next_size[tile] = qualities.size(tile, 0)
            planner.arrive(tile, tile_delivery.time)
            planner.fill(loaded, finer_tiles())
        frustum, eye = view.frustum(pose), pose.position
        cut = cut_tree(tree, frustum, view.max_error)
        recorder.frame(pose.time, cut, loaded)
        planner.frame(pose, cut, loaded)
        planner.fill(loaded, finer_tiles())
        count = int(cut.selected.sum())
        for seconds in moments:
            if seconds not in shots and pose.time >= path[0].time + seconds:
                shots[seconds] = _drawn_moment(tree, pose, cut, loaded, qualities)
        drawn_shares.append(int((cut.selected & loaded).sum()) / count if count else 1.0)
        received.append(recorder.bytes)
    return Simulation(
        policy=policy,
        metrics=recorder.summary(),
        times=tuple(pose.time for pose in path),
        share_loaded=tuple(drawn_shares),
        received=tuple(received),
        prediction=prediction_error(tree, path, predictor(), view)
        if policy == "predictive"
        else None,
        moments=shots,
    )


def _drawn_moment(
    tree: TileTree,
    pose: Pose,
    cut: TileCut,
    loaded: Bool[np.ndarray, " n"],
    qualities: TileQualities | None,
) -> DrawnMoment:
    drawn, wanted = (
        [int(row) for row in np.flatnonzero(mask) if tree.tiles[row].contents]
        for mask in (drawable_tiles(tree, cut, there) for there in (loaded, loaded | True))
    )
    files = {row: int(qualities.gpu_quality[row]) if qualities else 0 for row in drawn}
    return DrawnMoment(pose=pose, drawn=files, wanted=tuple(wanted))
