"""Poses camera → world, as most files have them, turned into views."""

__all__ = ["view_from_opencv", "view_from_opengl"]

from typing import Final

import numpy as np
from jaxtyping import Float

_FROM_OPENGL: Final = np.diag([1.0, -1.0, -1.0, 1.0])


def view_from_opencv(
    axes: Float[np.ndarray, "3 3"], center: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Return world → camera.

    Args:
        axes: The camera's +x right, +y down and +z forward in the world, a column each.
        center: Where it stands.
    """
    view = np.eye(4)
    view[:3, :3] = axes.T
    with np.errstate(all="ignore"):  # a camera at 1e300 is refused later
        view[:3, 3] = -axes.T @ center
    return view


def view_from_opengl(to_world: Float[np.ndarray, "_ 4"]) -> Float[np.ndarray, "4 4"]:
    """Return world → camera from camera → world of a camera with +y up and +z backward.

    Args:
        to_world: Three or four rows.
    """
    return np.asarray(_FROM_OPENGL @ view_from_opencv(to_world[:3, :3], to_world[:3, 3]))
