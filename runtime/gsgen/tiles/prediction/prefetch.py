"""Prefetching: which tiles will the camera need soon, by predicted poses or a known path?"""

__all__ = ["HorizonPrefetch", "PathPrefetch", "Prefetch", "ViewSettings"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, final

import numpy as np
from jaxtyping import Bool, Float64

from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.predictor import Predictor
from gsgen.tiles.selection.cut import cut_tree
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.request_order import request_order
from gsgen.tiles.selection.tile_tree import TileTree

HORIZON: Final = 2.0
"""Seconds ahead for which tiles are fetched."""
MOST_WASTE: Final = 0.15
"""Share of the bytes that may be wasted: above it the horizon is halved."""

_SHARES: Final = (0.125, 0.25, 0.5, 1.0)  # of the horizon: the moments that are looked at
_TRUST: Final = (1.0, 0.9, 0.75, 0.6)  # of the largest waste: later moments leave room for sooner
_INTERVAL: Final = 0.1  # seconds between plans
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
        """Return the tiles that predicted poses see, the earliest first, in order of request."""
        if self._planned is None:
            self._planned = self._time
            self._order = self._plan()
        return [(tile, trust) for tile, trust in self._order if not loaded[tile]]

    def _plan(self) -> list[tuple[int, float]]:
        reach = min(self.horizon, self._predictor.reach)
        trusts: dict[int, float] = {}  # in order of the first predicted pose that sees each tile
        poses = self._predictor.predict([reach * share for share in _SHARES])
        for pose, trust in zip(poses, _TRUST, strict=False):
            frustum = self._frustum_at(pose.position, pose.quaternion)
            cut = cut_tree(self._tree, frustum, self._max_error)
            for tile in request_order(self._tree, cut).tolist():
                trusts.setdefault(tile, trust)
        return list(trusts.items())


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
