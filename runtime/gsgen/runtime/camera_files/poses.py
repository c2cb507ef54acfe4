"""Converts camera-to-world poses of files to world-to-camera matrices."""

__all__ = ["view_from_opencv", "view_from_opengl"]

from typing import Final

import numpy as np
from jaxtyping import Float

_OPENCV_FROM_OPENGL: Final = np.diag([1.0, -1.0, -1.0, 1.0])


def view_from_opencv(
    axes: Float[np.ndarray, "3 3"], center: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Return the world-to-camera matrix of an OpenCV camera.

    Args:
        axes: The camera's +x right, +y down and +z forward in the world, as columns.
        center: The camera centre.
    """
    view = np.eye(4)
    view[:3, :3] = axes.T
    with np.errstate(all="ignore"):  # ``Camera`` refuses numbers such as 1e300 later
        view[:3, 3] = -axes.T @ center
    return view


def view_from_opengl(to_world: Float[np.ndarray, "_ 4"]) -> Float[np.ndarray, "4 4"]:
    """Convert an OpenGL camera-to-world matrix, 3 or 4 rows, to an OpenCV world-to-camera one."""
    return np.asarray(_OPENCV_FROM_OPENGL @ view_from_opencv(to_world[:3, :3], to_world[:3, 3]))
