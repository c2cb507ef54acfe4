"""Spaces in which centres may be given by mistake, so that they follow the camera."""

__all__ = ["space_of_still_rows"]

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Final

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.causes.readings import (
    MAX_INVALID_SHARE,
    Explanation,
    SeenRows,
    hidden_mask,
    share_of,
)

# Centres follow the camera if they move by more than the first fraction of their spread, and by
# less than the second once the camera is undone.
_MIN_MOTION_RATIO = 0.05
_MAX_RESIDUAL_RATIO = 2e-3
# A fraction of the camera's centre by which centres move.
_MIN_FACTOR = 0.01
# A part of the rows may follow, such as actors before a static background, or a grid around the camera.
_MIN_MOVING_ROWS, _MIN_MOVING_SHARE = 4, 0.05


def space_of_still_rows(cameras: Sequence[SeenRows]) -> Explanation | None:
    """Return the space in which centres do not move, if they follow the camera as declared."""
    for first, second in combinations(cameras[:3], 2):
        if first.position.shape != second.position.shape:
            continue
        drawn = first.drawn & second.drawn
        count = int(np.count_nonzero(drawn))
        if count < _MIN_MOVING_ROWS:
            continue
        motion = np.linalg.norm(first.position[drawn] - second.position[drawn], axis=1)
        extent = float(np.linalg.norm(np.ptp(first.position[drawn], axis=0)))
        is_moving = motion > _MIN_MOTION_RATIO * extent
        if np.count_nonzero(is_moving) < max(_MIN_MOVING_ROWS, _MIN_MOVING_SHARE * count):
            continue
        for name, (undo, hint) in {
            **_SPACES,
            **_partly_moved(first, second, is_moving, drawn),
        }.items():
            local_positions = [undo(camera) for camera in (first, second)]
            if any(points is None for points in local_positions):
                continue
            before, after = (
                points[drawn][is_moving] for points in local_positions if points is not None
            )
            spread = float(np.linalg.norm(np.ptp(before, axis=0)))
            residual = np.linalg.norm(before - after, axis=1)
            if not (spread > 0 and np.isfinite(residual).all()):
                continue
            is_misfit = (residual > _MAX_RESIDUAL_RATIO * spread) | hidden_mask(before, cameras)
            share = share_of(is_misfit)
            if share <= MAX_INVALID_SHARE:
                moving_share = share_of(is_moving)
                return Explanation(
                    kind="space",
                    name=name,
                    declared=moving_share,
                    fraction=share,
                    rows=count,
                    hint=hint,
                )
    return None


def _in_camera_space(camera: SeenRows) -> Float[np.ndarray, "n 3"] | None:
    return None if camera.view is None else _undo_matrix(camera.view, camera.position)


def _in_opengl_space(camera: SeenRows) -> Float[np.ndarray, "n 3"] | None:
    if camera.view is None:
        return None
    return _undo_matrix(camera.view, camera.position * [1, -1, -1])


def _in_clip_space(camera: SeenRows) -> Float[np.ndarray, "n 3"] | None:
    if camera.view is None or camera.projection is None:
        return None
    return _undo_matrix(camera.projection @ camera.view, camera.position)


def _undo_matrix(
    matrix: Float[np.ndarray, "4 4"], position: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"] | None:
    if abs(np.linalg.det(matrix)) < np.finfo(np.float64).eps:
        return None
    points = np.concatenate([position, np.ones((len(position), 1))], axis=1)
    positions = points @ np.linalg.inv(matrix).T
    return np.asarray(positions[:, :3] / positions[:, 3:])


def _relative_to_centre(camera: SeenRows) -> Float[np.ndarray, "n 3"]:
    return np.asarray(camera.position + camera.center)


def _moved_along(axes: str) -> Callable[[SeenRows], Float[np.ndarray, "n 3"]]:
    is_followed = np.array([axis in axes for axis in "xyz"])
    return lambda camera: np.asarray(camera.position - camera.center * is_followed)


def _partly_moved(
    first: SeenRows,
    second: SeenRows,
    is_moving: Bool[np.ndarray, " m"],
    drawn: Bool[np.ndarray, " n"],
) -> dict[str, tuple[Callable[[SeenRows], Float[np.ndarray, "n 3"] | None], str]]:
    """Return the space of centres that move by a fraction of the camera's motion, if that is one."""
    motion = np.median((second.position - first.position)[drawn][is_moving], axis=0)
    step = second.center - first.center
    factor = float(motion @ step / max(step @ step, np.finfo(float).tiny))
    if not abs(factor) >= _MIN_FACTOR:
        return {}
    return {
        f"moved by {factor:.3g} of the camera's centre": (
            lambda camera: np.asarray(camera.position - factor * camera.center),
            "Do not move the centres of the rows with the camera, far ones neither: fade or hide them.",
        )
    }


def _relative_to_translation(camera: SeenRows) -> Float[np.ndarray, "n 3"] | None:
    return None if camera.view is None else np.asarray(camera.position + camera.view[:3, 3])


def _turned_into_axes(camera: SeenRows) -> Float[np.ndarray, "n 3"] | None:
    return None if camera.view is None else np.asarray(camera.position @ camera.view[:3, :3])


def _moved_by_inverse(camera: SeenRows) -> Float[np.ndarray, "n 3"] | None:
    if camera.view is None:
        return None
    return np.asarray(camera.position @ camera.view[:3, :3].T + camera.view[:3, 3])


_BEFORE_MATRICES: Final = (
    "Return the centres before the view and projection matrices are applied to them."
)
# The space of centres → how it is undone, and the repair of the model.
_SPACES: Final[dict[str, tuple[Callable[[SeenRows], Float[np.ndarray, "n 3"] | None], str]]] = {
    "in camera space": (_in_camera_space, _BEFORE_MATRICES),
    "in the camera space of OpenGL": (_in_opengl_space, _BEFORE_MATRICES),
    "in clip space": (_in_clip_space, _BEFORE_MATRICES),
    "relative to the camera's centre": (
        _relative_to_centre,
        "Add the camera's centre, −Rᵀt of the view matrix, back to the centres of the rows.",
    ),
    "moved by the camera's centre": (
        _moved_along("xyz"),
        "Do not add the camera's centre to centres that are in local space already.",
    ),
    **{
        f"moved by the camera's centre along {' and '.join(axes)}": (
            _moved_along(axes),
            "Do not move the centres of the rows with the camera: place rows for the whole scene, and "
            "hide those that are far.",
        )
        for axes in ("xz", "xy", "yz", "x", "y", "z")
    },
    "relative to the translation of the view matrix": (
        _relative_to_translation,
        "Do not subtract the view matrix's translation from the centres of the rows.",
    ),
    "turned into the camera's axes": (
        _turned_into_axes,
        "Do not multiply the centres of the rows by the view matrix's rotation.",
    ),
    "moved by the inverse of the view matrix": (
        _moved_by_inverse,
        "Do not apply the camera-to-world matrix to centres that are in local space already.",
    ),
}
