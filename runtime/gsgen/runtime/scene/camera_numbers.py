"""Checks of the numbers that make a camera; errors name the attribute."""

__all__ = ["require_image_side", "require_number", "require_sphere", "unit_direction"]

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.errors import SceneInvalid

_LARGEST_SIDE: Final = 16_384
_FULL_TURN_TOLERANCE: Final = (
    1e-6  # relative tolerance: a panorama may be wider than a turn by this
)


def require_number(name: str, value: object, *, must_be_positive: bool = False) -> None:
    """Raise if a camera's attribute is not a finite number, or not a positive one."""
    is_finite = isinstance(value, int | float) and math.isfinite(value)
    if not is_finite or (must_be_positive and not float(value) > 0):  # type: ignore[arg-type]
        expected = "a positive number" if must_be_positive else "a finite number"
        raise SceneInvalid(f"is {value!r}, expected {expected}", where=f"camera.{name}")


def unit_direction(name: str, components: Sequence[float]) -> Float[np.ndarray, "3"]:
    """Return a direction of a camera as a vector of length 1; raise if it has none."""
    vector = np.asarray(components, np.float64)
    length = np.linalg.norm(vector)
    if vector.shape != (3,) or not 0 < length < math.inf:
        raise SceneInvalid(
            f"is {list(components)}, expected a direction of 3 numbers", where=f"camera.{name}"
        )
    return np.asarray(vector / length)


def require_image_side(name: str, value: object) -> None:
    """Raise if a width or height is not a whole number of pixels that can be drawn."""
    if not (isinstance(value, int | np.integer) and 1 <= value <= _LARGEST_SIDE):
        raise SceneInvalid(
            f"is {value!r}, expected an integer from 1 to {_LARGEST_SIDE}", where=f"camera.{name}"
        )


def require_sphere(fx: float, fy: float, cy: float, size: tuple[int, int]) -> None:
    """Raise if a panorama camera shows a direction twice, or a latitude beyond a pole."""
    (width, height), period = size, 2 * math.pi * fx
    if width > period * (1 + _FULL_TURN_TOLERANCE):
        raise SceneInvalid(
            f"is {fx} pixels per radian, {period:.6g} per turn, but the image is {width} wide",
            where="camera.fx",
            hint="A full panorama has fx = width / 2π, a part of one has more.",
        )
    top, bottom = -cy / fy, (height - cy) / fy
    if max(-top, bottom) > math.pi / 2 * (1 + _FULL_TURN_TOLERANCE):
        raise SceneInvalid(
            f"is such that the image shows latitudes from {math.degrees(-bottom):.6g} to "
            f"{math.degrees(-top):.6g} degrees, expected −90 to 90 at most",
            where="camera.cy",
            hint="A full panorama has cy = height / 2 and fy = height / π.",
        )
