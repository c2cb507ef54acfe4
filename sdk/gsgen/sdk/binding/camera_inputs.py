"""Derives the values of a model's camera inputs from a camera: matrices, centre, viewport."""

__all__ = ["FAR_RATIO", "Camera", "CameraLike", "Pinhole", "camera_values", "pinhole_projection"]

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from gsgen.sdk.binding.providers.errors import InputInvalid

_VIEWPORT_INPUT_NAMES = ("width", "height")
# The far plane of a camera without one, in multiples of the near plane: 1000 units for 0.01.
FAR_RATIO = 1e5

Matrix = Float[np.ndarray, "4 4"]


@runtime_checkable
class CameraLike(Protocol):
    """Protocol of a camera with view and projection matrices; width and height are optional.

    Both matrices multiply column vectors: the translation of ``view`` is in its last column.
    """

    @property
    def view(self) -> Matrix:
        """The world→camera matrix, with OpenCV axes."""

    @property
    def projection(self) -> Matrix:
        """The camera→clip matrix, with depth 0..1."""


@runtime_checkable
class Pinhole(Protocol):
    """Protocol of a camera with intrinsics (fx, fy, cx, cy), such as gsgen.runtime.Camera."""

    @property
    def view(self) -> Matrix:
        """The world→camera matrix, with OpenCV axes."""

    @property
    def fx(self) -> float:
        """Horizontal focal length, in pixels."""

    @property
    def fy(self) -> float:
        """Vertical focal length, in pixels."""

    @property
    def cx(self) -> float:
        """Distance of the principal point from the left edge of the image, in pixels."""

    @property
    def cy(self) -> float:
        """Distance of the principal point from the upper edge of the image, in pixels."""

    @property
    def width(self) -> int:
        """Width of the image, in pixels."""

    @property
    def height(self) -> int:
        """Height of the image, in pixels."""

    @property
    def near(self) -> float:
        """Distance of the near plane, in world units."""


Camera = CameraLike | Pinhole | Sequence[Matrix]


def camera_values(camera: Camera) -> dict[str, np.ndarray]:
    """Return a camera's values by input role: view, projection, camera centre, viewport.

    ``camera`` has both matrices, or a view and intrinsics, or is the pair (view, projection).
    """
    view, projection = _matrices(camera)
    world_to_camera = np.asarray(view, np.float64)
    if world_to_camera.shape != (4, 4):
        message = f"has shape {list(world_to_camera.shape)}, expected [4, 4]"
        raise InputInvalid(message, where="camera.view")
    values = {"view": world_to_camera, "projection": np.asarray(projection)}
    values["camera_position"] = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
    if all(hasattr(camera, name) for name in _VIEWPORT_INPUT_NAMES):
        values["viewport"] = np.asarray([getattr(camera, name) for name in _VIEWPORT_INPUT_NAMES])
    return values


def _matrices(camera: Camera) -> tuple[Matrix, Matrix]:
    if isinstance(camera, CameraLike):
        return camera.view, camera.projection
    if isinstance(camera, Pinhole):
        return camera.view, pinhole_projection(camera)
    try:
        view, projection = camera
    except (TypeError, ValueError) as error:
        expected = ".view and .projection, .view and intrinsics, or the pair of matrices"
        message = f"the camera is a {type(camera).__name__}, expected {expected}"
        raise InputInvalid(message, where="camera") from error
    return view, projection


def pinhole_projection(camera: Pinhole) -> Matrix:
    """Return the camera→clip matrix [4, 4] of a pinhole camera, with depth 0..1.

    A pixel (u, v) = (fx x/z + cx, fy y/z + cy) is at (2u/width − 1, 1 − 2v/height) in clip space.
    """
    near = float(camera.near)
    far = float(getattr(camera, "far", FAR_RATIO * near))
    matrix = np.zeros((4, 4))
    matrix[0, [0, 2]] = 2 * camera.fx / camera.width, 2 * camera.cx / camera.width - 1
    matrix[1, [1, 2]] = -2 * camera.fy / camera.height, 1 - 2 * camera.cy / camera.height
    matrix[2, 2:] = far / (far - near), -near * far / (far - near)
    matrix[3, 2] = 1
    return matrix
