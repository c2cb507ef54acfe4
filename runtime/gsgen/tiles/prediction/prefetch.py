"""Prefetching: which tiles will the camera need soon, by predicted poses or a known path?"""

__all__ = ["HorizonPrefetch", "PathPrefetch", "Prefetch", "ViewSettings"]

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, final

import numpy as np
from jaxtyping import Bool, Int64

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.runtime.scene.camera import Camera
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
_MOST_PATH_TILES: Final = 16  # that are looked for at once


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

    def camera(self, pose: Pose) -> Camera:
        """Return the pinhole camera of a pose, whose principal point is the image centre."""
        view, focal = np.eye(4), self.height / 2 / math.tan(math.radians(self.fov_y) / 2)
        view[:3, :3] = rotation_matrix(pose.quaternion[None] / np.linalg.norm(pose.quaternion))[0].T
        view[:3, 3] = -view[:3, :3] @ pose.position
        return Camera(
            view,
            fx=focal,
            fy=focal,
            cx=self.width / 2,
            cy=self.height / 2,
            width=self.width,
            height=self.height,
        )

    def frustum(self, pose: Pose) -> Frustum:
        """Return the view frustum of a camera pose."""
        return Frustum.from_camera(self.camera(pose))


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
        frustum_at: Returns the frustum of a pose.
        max_error: Screen-space error above which tiles are refined, in pixels.
    """

    def __init__(
        self,
        tree: TileTree,
        predictor: Predictor,
        frustum_at: Callable[[Pose], Frustum],
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
            cut = cut_tree(self._tree, self._frustum_at(pose), self._max_error)
            order.update(dict.fromkeys(request_order(self._tree, cut).tolist()))
        return list(order)


@final
class PathPrefetch:
    """Prefetches the tiles of the frames to come of a known camera path, the earliest first.

    Attributes:
        is_film: Whether frames wait for their tiles, so that they have no times.

    Args:
        tree: The tiles.
        frustums: Of all frames, in order.
        max_error: Screen-space error above which tiles are refined, in pixels.
        times: Of the frames, in seconds, ascending; None for a film.
        slots: Slots of GPU memory that each tile needs.
        capacity: Slots for the tiles of the frames ahead: more would displace each other.
    """

    def __init__(
        self,
        tree: TileTree,
        frustums: Sequence[Frustum],
        max_error: float,
        *,
        times: Sequence[float] | None = None,
        slots: Int64[np.ndarray, " n"] | None = None,
        capacity: float = math.inf,
    ) -> None:
        self._tree, self._frustums, self._max_error = tree, frustums, max_error
        self._frame_times, self.is_film = times, times is None
        self._slots = np.zeros(len(tree), np.int64) if slots is None else slots
        self._capacity = capacity
        self._frame = 0
        self._orders: dict[int, Int64[np.ndarray, " m"]] = {}

    def observe(self, pose: Pose) -> None:
        """Forget the frames up to the one that is drawn now."""
        if self._frame_times is not None:
            self._frame = bisect_right(self._frame_times, pose.time)
        else:
            turn = rotation_matrix(pose.quaternion[None])[0].T
            for frame, view in enumerate(self._frustums[self._frame :], self._frame):
                is_same_eye = np.array_equal(view.eye, pose.position)
                is_same_eye = is_same_eye and pose.focal in (None, view.focal)
                if is_same_eye and np.allclose(view.rotation, turn, rtol=0, atol=1e-9):
                    self._frame = frame
                    break
        for frame in [frame for frame in self._orders if frame < self._frame]:
            del self._orders[frame]

    def candidates(self, loaded: Bool[np.ndarray, " n"]) -> list[int]:
        """Return the missing tiles of the frames to come, the earliest first, as far as they fit."""
        ahead = np.zeros(len(self._tree), bool)
        missing: list[int] = []
        for frame in range(self._frame, len(self._frustums)):
            order = self._order(frame)
            entries = order[~ahead[order]]
            ahead[entries] = True
            if int(self._slots[ahead].sum()) > self._capacity:
                break
            missing += entries[~loaded[entries]].tolist()
            if len(missing) >= _MOST_PATH_TILES:
                break
        return missing

    def _order(self, frame: int) -> Int64[np.ndarray, " m"]:
        """Return the tiles that a frame of the path sees, in order of request."""
        if frame not in self._orders:
            cut = cut_tree(self._tree, self._frustums[frame], self._max_error)
            self._orders[frame] = request_order(self._tree, cut)
        return self._orders[frame]
