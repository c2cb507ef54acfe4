"""A camera as a session takes it: matrices as they are written in mathematics."""

__all__ = ["CAMERA_ROLES", "CameraLike", "camera_values"]

from collections.abc import Sequence
from typing import Protocol, cast, runtime_checkable

import numpy as np
from jaxtyping import Float

from gsgen.sdk.binding.errors import InputInvalid

CAMERA_ROLES = frozenset({"view", "projection", "camera_position", "viewport"})
_VIEWPORT = ("width", "height")


@runtime_checkable
class CameraLike(Protocol):
    """Anything with the two matrices of a camera; ``width`` and ``height`` are used if there.

    Both matrices multiply column vectors: the translation of ``view`` is in its last column.
    """

    @property
    def view(self) -> Float[np.ndarray, "4 4"]:
        """World→camera, OpenCV axes."""

    @property
    def projection(self) -> Float[np.ndarray, "4 4"]:
        """Camera→clip, depth 0..1."""


def camera_values(
    camera: CameraLike | Sequence[Float[np.ndarray, "4 4"]],
) -> dict[str, np.ndarray]:
    """Return what a camera tells each role: view, projection, camera_position, viewport.

    Args:
        camera: An object with both matrices, or the pair (view, projection).

    Raises:
        InputInvalid: It is neither.
    """
    if isinstance(camera, CameraLike):
        view, projection = camera.view, camera.projection
    else:
        try:
            view, projection = camera
        except (TypeError, ValueError) as error:
            what = (
                f"is a {type(camera).__name__}, wanted .view and .projection, or the pair"
            )
            raise InputInvalid(what, where="camera") from error
    world = np.asarray(view, np.float64)
    if world.shape != (4, 4):
        raise InputInvalid(
            f"has shape {list(world.shape)}, wanted [4, 4]", where="camera.view"
        )
    values = {"view": world, "projection": np.asarray(projection)}
    values["camera_position"] = -world[:3, :3].T @ world[:3, 3]
    if all(hasattr(camera, name) for name in _VIEWPORT):
        size = [cast(float, getattr(camera, name)) for name in _VIEWPORT]
        values["viewport"] = np.asarray(size, np.float64)
    return values
