"""Prefetching: which tiles will the camera need soon, by predicted poses or a known path?"""

__all__ = ["FilmPrefetch", "HorizonPrefetch", "PathPrefetch", "Prefetch", "ViewSettings"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.predictor import Predictor
from gsgen.tiles.selection.cut import cut_tree
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.request_order import request_order
from gsgen.tiles.selection.tile_tree import TileTree

PREDICTION_HORIZON: Final = 2.0
"""Seconds ahead for which tiles are fetched."""
HORIZON_FRACTIONS: Final = (0.125, 0.25, 0.5, 1.0)
"""Of the horizon: the moments whose cameras are predicted."""
PLAN_INTERVAL_SECONDS: Final = 0.1
"""Seconds between two predictions of the tiles that will be seen."""


_MOST_FILM_TILES: Final = 16  # that are looked for at once


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

    def observe(self, pose: Pose) -> None:
        """Record the camera pose of a frame."""
        ...

    def candidates(self, loaded: Bool[np.ndarray, " n"]) -> list[int]:
        """Return missing tiles that the camera will need, the most urgent first."""
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
        self._time = 0.0
        self._last_plan_time: float | None = None
        self._tile_order: list[int] = []

    def observe(self, pose: Pose) -> None:
        """Record the camera pose of a frame."""
        self._predictor.observe(pose)
        self._time = pose.time

    def candidates(self, loaded: Bool[np.ndarray, " n"]) -> list[int]:
        """Return the tiles that predicted poses see, the earliest first, in order of request."""
        if (
            self._last_plan_time is None
            or self._time - self._last_plan_time >= PLAN_INTERVAL_SECONDS
        ):
            self._last_plan_time = self._time
            self._tile_order = self._plan()
        return [tile for tile in self._tile_order if not loaded[tile]]

    def _plan(self) -> list[int]:
        reach = min(PREDICTION_HORIZON, self._predictor.reach)
        order: dict[int, None] = {}  # each tile once, where the first predicted pose sees it
        for pose in self._predictor.predict([reach * share for share in HORIZON_FRACTIONS]):
            frustum = self._frustum_at(pose.position, pose.quaternion)
            cut = cut_tree(self._tree, frustum, self._max_error)
            order.update(dict.fromkeys(request_order(self._tree, cut).tolist()))
        return list(order)


@final
class FilmPrefetch:
    """Prefetches the tiles of the frames to come, in the order of the frames.

    Args:
        tree: The tiles.
        frustums: Of all frames, in order.
        max_error: Screen-space error above which tiles are refined, in pixels.
        slots: Slots of GPU memory that each tile needs.
        capacity: Slots for the tiles of the frames ahead: more would displace each other.
    """

    def __init__(
        self,
        tree: TileTree,
        frustums: Sequence[Frustum],
        max_error: float,
        slots: Int64[np.ndarray, " n"],
        capacity: int,
    ) -> None:
        self._tree, self._max_error, self._slots = tree, max_error, slots
        self._frames, self._capacity = list(frustums), capacity

    def observe(self, pose: Pose) -> None:
        """Forget the frames up to the one that is drawn now."""
        for index, frustum in enumerate(self._frames):
            if np.array_equal(frustum.eye, pose.position):
                del self._frames[:index]
                return

    def candidates(self, loaded: Bool[np.ndarray, " n"]) -> list[int]:
        """Return the missing tiles of the frames to come, the earliest first, as far as they fit."""
        ahead = np.zeros(len(self._tree), bool)
        tiles: dict[int, None] = {}
        for frustum in self._frames:
            cut = cut_tree(self._tree, frustum, self._max_error)
            ahead |= cut.seen
            if int(self._slots[ahead].sum()) > self._capacity:
                break
            tiles.update(dict.fromkeys(request_order(self._tree, cut).tolist()))
            if sum(not loaded[tile] for tile in tiles) >= _MOST_FILM_TILES:
                break
        return [tile for tile in tiles if not loaded[tile]]


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
        was_needed = np.zeros(len(tree), bool)
        for pose in path:
            cut = cut_tree(tree, frustum_at(pose.position, pose.quaternion), max_error)
            for tile in np.flatnonzero(cut.selected & ~was_needed).tolist():
                self._times[tile].append(pose.time)
            was_needed = cut.selected
        self._time = -np.inf

    def observe(self, pose: Pose) -> None:
        """Record a frame's time: tiles that the known camera path needs later are prefetched."""
        self._time = pose.time

    def candidates(self, loaded: Bool[np.ndarray, " n"]) -> list[int]:
        """Return the tiles that a known camera path will need, the earliest first."""
        entries = [
            (next((time for time in times if time > self._time), np.inf), tile)
            for tile, times in enumerate(self._times)
            if times and not loaded[tile]
        ]
        return [tile for time, tile in sorted(entries) if time < np.inf]
