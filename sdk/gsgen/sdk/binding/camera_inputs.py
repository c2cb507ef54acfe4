"""A camera as a session takes it: matrices as they are written in mathematics."""

__all__ = ["Camera", "CameraLike", "Pinhole", "camera_values", "pinhole_projection"]

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from gsgen.sdk.binding.providers.errors import InputInvalid

_VIEWPORT = ("width", "height")
# Where a camera names no far plane, this many times the near plane; 1000 units from 0.01.
_FAR = 1e5

Matrix = Float[np.ndarray, "4 4"]


@runtime_checkable
class CameraLike(Protocol):
    """Anything with the two matrices of a camera; ``width`` and ``height`` are used if there.

    Both matrices multiply column vectors: the translation of ``view`` is in its last column.
    """

    @property
    def view(self) -> Matrix:
        """World→camera, OpenCV axes."""

    @property
    def projection(self) -> Matrix:
        """Camera→clip, depth 0..1."""


@runtime_checkable
class Pinhole(Protocol):
    """A camera by its intrinsics, such as :class:`gsgen.runtime.Camera`; ``far`` is used if there."""

    @property
    def view(self) -> Matrix:
        """World→camera, OpenCV axes."""

    @property
    def fx(self) -> float:
        """Horizontal focal length, in pixels."""

    @property
    def fy(self) -> float:
        """Vertical focal length, in pixels."""

    @property
    def cx(self) -> float:
        """Principal point from the left edge, in pixels."""

    @property
    def cy(self) -> float:
        """Principal point from the upper edge, in pixels."""

    @property
    def width(self) -> int:
        """Of the image, in pixels."""

    @property
    def height(self) -> int:
        """Of the image, in pixels."""

    @property
    def near(self) -> float:
        """Distance of the near plane, in world units."""


Camera = CameraLike | Pinhole | Sequence[Matrix]


def camera_values(camera: Camera) -> dict[str, np.ndarray]:
    """Return what a camera tells each role: view, projection, camera_position, viewport.

    Args:
        camera: An object with both matrices or with a view and intrinsics, or the pair
            (view, projection).

    Raises:
        InputInvalid: It is none of these.
    """
    view, projection = _matrices(camera)
    world = np.asarray(view, np.float64)
    if world.shape != (4, 4):
        what = f"has shape {list(world.shape)}, wanted [4, 4]"
        raise InputInvalid(what, where="camera.view")
    values = {"view": world, "projection": np.asarray(projection)}
    values["camera_position"] = -world[:3, :3].T @ world[:3, 3]
    if all(hasattr(camera, name) for name in _VIEWPORT):
        values["viewport"] = np.asarray([getattr(camera, name) for name in _VIEWPORT])
    return values


def _matrices(camera: Camera) -> tuple[Matrix, Matrix]:
    if isinstance(camera, CameraLike):
        return camera.view, camera.projection
    if isinstance(camera, Pinhole):
        return camera.view, pinhole_projection(camera)
    try:
        view, projection = camera
    except (TypeError, ValueError) as error:
        what = f"is a {type(camera).__name__}"
        expected = (
            "wanted .view and .projection, .view and intrinsics, or the pair of matrices"
        )
        raise InputInvalid(f"{what}, {expected}", where="camera") from error
    return view, projection


def pinhole_projection(camera: Pinhole) -> Matrix:
    """Return the camera→clip matrix: as the specification of conventions has it, off-centre too.

    A pixel (u, v) = (fx x/z + cx, fy y/z + cy) is at (2u/width − 1, 1 − 2v/height) in clip space.
    """
    near = float(camera.near)
    far = float(getattr(camera, "far", _FAR * near))
    matrix = np.zeros((4, 4))
    matrix[0, [0, 2]] = 2 * camera.fx / camera.width, 2 * camera.cx / camera.width - 1
    matrix[1, [1, 2]] = -2 * camera.fy / camera.height, 1 - 2 * camera.cy / camera.height
    matrix[2, 2:] = far / (far - near), -near * far / (far - near)
    matrix[3, 2] = 1
    return matrix
