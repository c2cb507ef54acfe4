"""Prefetching: which tiles will the camera need soon, by predicted poses or a known path?"""

__all__ = ["HorizonPrefetch", "PathPrefetch", "Prefetch", "ViewSettings"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, final

import numpy as np
from jaxtyping import Bool, Float64

from gsgen.tiles.prediction.poses import Pose, quaternion_product, rotation_quaternion
from gsgen.tiles.prediction.predictor import Prediction, Predictor
from gsgen.tiles.selection.cut import cut_tree, cut_tree_often
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.tile_tree import TileTree

HORIZON: Final = 2.0
"""Seconds ahead for which tiles are fetched."""
MOST_WASTE: Final = 0.15
"""Share of the bytes that may be wasted: above it the horizon is halved."""

_SHARES: Final = (0.125, 0.25, 0.5, 1.0)  # of the horizon: the moments that are looked at
_TRUST: Final = (1.0, 0.9, 0.75, 0.6)  # of the largest waste: later moments leave room for sooner
_LEAST_PROBABILITY: Final = 0.5
_INTERVAL: Final = 0.1  # seconds between plans
_STATE: Final = 6
_LEAST_HORIZON: Final = 0.125


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ViewSettings:
    """The image size, field of view and pixel error with which a client selects tiles.

    Attributes:
        width: In pixels.
        height: In pixels.
        fov_y: Vertical field of view, in degrees.
        max_error: Screen-space error above which tiles are refined, in pixels.
    """

    width: int = 1280
    height: int = 720
    fov_y: float = 50.0
    max_error: float = 16.0

    def frustum(
        self, position: Float64[np.ndarray, " 3"], quaternion: Float64[np.ndarray, " 4"]
    ) -> Frustum:
        """Return the view frustum of a camera pose."""
        return Frustum.from_pose(
            position, quaternion, width=self.width, height=self.height, fov_y=self.fov_y
        )


class Prefetch(Protocol):
    """Protocol of prefetchers: predict which tiles the camera will need soon."""

    def observe(self, pose: Pose, waste: float) -> None:
        """Record the camera pose of a frame, and the share of received bytes that were wasted."""
        ...

    def candidates(self, loaded: Bool[np.ndarray, " n"]) -> list[tuple[int, float]]:
        """Return missing tiles that the camera will need, the most urgent first.

        Each comes with the share of the largest waste that may be risked for it.
        """
        ...


@final
class HorizonPrefetch:
    """Prefetches the tiles that predicted camera poses see within a time horizon.

    Sixteen sigma points stand for the uncertainty of each predicted pose: the pose itself four
    times, and √6 standard deviations to both sides of it in each of the six dimensions
    (Julier and Uhlmann 1997). The probability of a tile is the share of the points that see it.

    Args:
        tree: The tiles.
        predictor: Of the camera.
        frustum_at: Returns the frustum of a position and a quaternion.
        max_error: Screen-space error above which tiles are refined, in pixels.
    """

    def __init__(
        self,
        tree: TileTree,
        predictor: Predictor,
        frustum_at: Callable[[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 4"]], Frustum],
        max_error: float,
    ) -> None:
        self._tree, self._predictor = tree, predictor
        self._frustum_at, self._max_error = frustum_at, max_error
        self.horizon = HORIZON
        self._time = 0.0
        self._planned: float | None = None
        self._order: list[tuple[int, float]] = []

    def observe(self, pose: Pose, waste: float) -> None:
        """Record a camera pose; halve the prediction horizon if too many bytes were wasted."""
        self._predictor.observe(pose)
        self._time = pose.time
        if self._planned is not None and self._time - self._planned < _INTERVAL:
            return
        self._planned = None
        longer, shorter = min(HORIZON, self.horizon * 1.05), max(_LEAST_HORIZON, self.horizon / 2)
        self.horizon = shorter if waste > MOST_WASTE else longer

    def candidates(self, loaded: Bool[np.ndarray, " n"]) -> list[tuple[int, float]]:
        """Return the tiles that are likely to be seen, the earliest and coarsest first."""
        if self._planned is None:
            self._planned = self._time
            self._order = self._plan()
        return [(tile, trust) for tile, trust in self._order if not loaded[tile]]

    def _plan(self) -> list[tuple[int, float]]:
        reach = min(self.horizon, self._predictor.reach)
        prediction = self._predictor.predict([reach * share for share in _SHARES])
        if prediction is None:
            return []
        probability = self._probability(prediction)
        likely = probability >= _LEAST_PROBABILITY
        rows = np.flatnonzero(likely.any(axis=0))
        first = likely.argmax(axis=0)[rows]
        order = np.lexsort((rows, -probability[first, rows], self._tree.level[rows], first))
        return [(int(rows[row]), _TRUST[first[row]]) for row in order]

    def _probability(self, prediction: Prediction) -> Float64[np.ndarray, "k n"]:
        """Return the probability that each tile is seen at each predicted camera pose."""
        positions, quaternions, weights = [], [], []
        for position, quaternion, deviation in zip(
            prediction.position, prediction.quaternion, prediction.deviation, strict=True
        ):
            positions.append(position)
            quaternions.append(quaternion)
            weights.append(4 / 16)
            for sign in (1, -1):
                for axis in range(_STATE):
                    offset = np.zeros(_STATE)
                    offset[axis] = sign * np.sqrt(_STATE) * deviation[axis]
                    positions.append(position + offset[:3])
                    quaternions.append(
                        quaternion_product(rotation_quaternion(offset[3:]), quaternion)
                    )
                    weights.append(1 / 16)
        middle = self._frustum_at(positions[0], quaternions[0])
        frusta = middle.moved_often(np.array(positions), np.array(quaternions))
        rows, seen = cut_tree_often(self._tree, frusta, self._max_error)
        points = 1 + 2 * _STATE
        shares = (seen * np.array(weights)[:, None]).reshape(-1, points, len(rows)).sum(axis=1)
        probability = np.zeros((len(shares), len(self._tree)))
        probability[:, rows] = shares
        return probability


@final
class PathPrefetch:
    """Prefetches tiles along a camera path known in advance: the best case of prediction.

    Args:
        tree: The tiles.
        path: All poses of the path.
        frustum_at: Returns the frustum of a position and a quaternion.
        max_error: Screen-space error above which tiles are refined, in pixels.
    """

    def __init__(
        self,
        tree: TileTree,
        path: Sequence[Pose],
        frustum_at: Callable[[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 4"]], Frustum],
        max_error: float,
    ) -> None:
        self._times: list[list[float]] = [[] for _ in tree.tiles]
        before = np.zeros(len(tree), bool)
        for pose in path:
            cut = cut_tree(tree, frustum_at(pose.position, pose.quaternion), max_error)
            for tile in np.flatnonzero(cut.wanted & ~before).tolist():
                self._times[tile].append(pose.time)
            before = cut.wanted
        self._time = -np.inf

    def observe(self, pose: Pose, waste: float) -> None:
        """Record a frame's time: tiles that the known camera path needs later are prefetched."""
        del waste
        self._time = pose.time

    def candidates(self, loaded: Bool[np.ndarray, " n"]) -> list[tuple[int, float]]:
        """Return the tiles that a known camera path will need, the earliest first."""
        entries = [
            (next((time for time in times if time > self._time), np.inf), tile)
            for tile, times in enumerate(self._times)
            if times and not loaded[tile]
        ]
        return [(tile, 1.0) for time, tile in sorted(entries) if time < np.inf]
