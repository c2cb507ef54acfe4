"""Lens distortion: where a lens moves the points of the image plane, and how far it is one-to-one.

The terms are those of OpenCV ("Camera Calibration and 3D Reconstruction") and COLMAP ("Camera
Models"), in one formula. A pinhole applies them to (x/z, y/z), a fisheye to θ (x, y)/ρ, with the
angle θ from the axis and ρ² = x² + y². For a point p = (u, v) with s = u² + v²::

    p (1 + k1 s + k2 s² + k3 s³ + k4 s⁴) / (1 + d1 s + d2 s² + d3 s³)
    + (2 p1 u v + p2 (s + 2 u²) + s1 s,  2 p2 u v + p1 (s + 2 v²) + s2 s)
"""

__all__ = ["Distortion", "Points", "undistorted_bounds"]

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from typing import Final, final

import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from gsgen.runtime.errors import SceneInvalid

Points = Float[np.ndarray, "n 2"]

_LENGTHS: Final = {"radial": 4, "divisor": 3, "tangential": 2, "prism": 2}
_DIRECTIONS: Final = 32  # in which a lens that is not symmetric is searched for folds
_SEARCH_RADII: Final = 1024
_HALVINGS: Final = 60
_NEWTON_STEPS: Final = 20
_BORDER_POINTS: Final = 65  # of each side of an image, whose rays bound those of the image
_LARGEST_COEFFICIENT: Final = 1e6  # those of calibrations are below a thousand


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Distortion:
    """The coefficients of a lens distortion; those of no distortion are 0.

    Attributes:
        radial: k1 to k4.
        divisor: d1 to d3, which OpenCV's rational model calls k4 to k6.
        tangential: p1 and p2.
        prism: s1 and s2 of a thin prism, which COLMAP calls sx1 and sy1.

    Raises:
        SceneInvalid: A coefficient is not a number up to 1e6, or their number is another one.
    """

    radial: tuple[float, ...] = (0.0,) * _LENGTHS["radial"]
    divisor: tuple[float, ...] = (0.0,) * _LENGTHS["divisor"]
    tangential: tuple[float, ...] = (0.0,) * _LENGTHS["tangential"]
    prism: tuple[float, ...] = (0.0,) * _LENGTHS["prism"]

    def __post_init__(self) -> None:
        for name, length in _LENGTHS.items():
            values = getattr(self, name)
            is_valid = isinstance(values, list | tuple) and len(values) == length
            if not is_valid or not all(_is_finite(value) for value in values):
                raise SceneInvalid(
                    f"is {values!r}, expected {length} numbers up to 1e6",
                    where=f"camera.distortion.{name}",
                )
            object.__setattr__(self, name, tuple(float(value) for value in values))

    @classmethod
    def of(cls, coefficients: Mapping[str, float], *, is_rational: bool = False) -> "Distortion":
        """Return the distortion with coefficients k1 … k6, p1, p2, s1, s2; absent ones are 0.

        Args:
            coefficients: Values by OpenCV's names.
            is_rational: Whether k4, k5 and k6 are those of the divisor, as in OpenCV's rational
                model, and not k4 that of the eighth power of the radius.
        """
        values = {
            name: coefficients.get(name, 0.0) for name in ("k1", "k2", "k3", "k4", "k5", "k6")
        }
        k4 = 0.0 if is_rational else values["k4"]
        divisor = (values["k4"], values["k5"], values["k6"]) if is_rational else (0.0, 0.0, 0.0)
        return cls(
            radial=(values["k1"], values["k2"], values["k3"], k4),
            divisor=divisor,
            tangential=(coefficients.get("p1", 0.0), coefficients.get("p2", 0.0)),
            prism=(coefficients.get("s1", 0.0), coefficients.get("s2", 0.0)),
        )

    @classmethod
    def from_dict(cls, document: object) -> "Distortion":
        """Build a distortion from a mapping with some of its attributes.

        Raises:
            SceneInvalid: A field is unknown or invalid.
        """
        names = [field.name for field in fields(cls)]
        if not isinstance(document, Mapping) or not set(document) <= set(names):
            raise SceneInvalid(
                f"is {str(document)[:80]}, expected an object with some of {', '.join(names)}",
                where="camera.distortion",
            )
        return cls(**document)

    def to_dict(self) -> dict[str, tuple[float, ...]]:
        """Return the attributes by name."""
        return asdict(self)

    @property
    def is_zero(self) -> bool:
        """Whether the lens moves no point."""
        return not any(value for name in _LENGTHS for value in getattr(self, name))

    def distorted(self, points: Points) -> Points:
        """Return where the lens moves points of the image plane, [n, 2]."""
        u, v = points.T
        s = u * u + v * v
        (p1, p2), (s1, s2) = self.tangential, self.prism
        factor = self._numerator(s) / self._denominator(s)
        du = 2 * p1 * u * v + p2 * (s + 2 * u * u) + s1 * s
        dv = 2 * p2 * u * v + p1 * (s + 2 * v * v) + s2 * s
        return np.stack([u * factor + du, v * factor + dv], axis=-1)

    def jacobian(self, points: Points) -> Float[np.ndarray, "n 2 2"]:
        """Return the derivatives of :meth:`distorted` by the points, [n, 2, 2]."""
        u, v = points.T
        s = u * u + v * v
        (p1, p2), (s1, s2) = self.tangential, self.prism
        bottom = self._denominator(s)
        factor = self._numerator(s) / bottom
        slope = (self._numerator.deriv()(s) - factor * self._denominator.deriv()(s)) / bottom
        across = 2 * u * v * slope + 2 * p1 * u + 2 * p2 * v
        uu = factor + 2 * u * u * slope + 2 * p1 * v + 6 * p2 * u + 2 * s1 * u
        vv = factor + 2 * v * v * slope + 2 * p2 * u + 6 * p1 * v + 2 * s2 * v
        rows = [np.stack([uu, across + 2 * s1 * v], -1), np.stack([across + 2 * s2 * u, vv], -1)]
        return np.stack(rows, axis=-2)

    def fold_radius(self, limit: float) -> float:
        """Return the radius below which the lens moves no two points to the same place.

        It is the least radius at which the determinant of the derivative, or the divisor, is not
        positive, in any direction; ``limit`` if there is none below it.
        """
        return _fold_radius(self, limit)

    def undistorted(self, points: Points, limit: float) -> Points:
        """Return the points within ``limit`` that the lens moves to ``points``, or the nearest ones."""
        # Step 1: halve the range of radii, as if the lens were symmetric.
        target = np.linalg.norm(points, axis=1)
        low, high = np.zeros(len(points)), np.full(len(points), limit)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            s = middle * middle
            is_below = middle * self._numerator(s) / self._denominator(s) < target
            low, high = np.where(is_below, middle, low), np.where(is_below, high, middle)
        radius = ((low + high) / 2)[:, None]
        result = points * radius / np.where(target > 0, target, 1)[:, None]
        if not any((*self.tangential, *self.prism)):
            return np.asarray(result)
        # Step 2: improve by Newton's method what is not symmetric.
        for _ in range(_NEWTON_STEPS):
            error = (self.distorted(result) - points)[:, :, None]
            result = result - (np.linalg.pinv(self.jacobian(result)) @ error)[:, :, 0]
            length = np.linalg.norm(result, axis=1, keepdims=True)
            result = result * np.minimum(1, limit / np.maximum(length, limit))
        return np.asarray(result)

    @property
    def _numerator(self) -> Polynomial:
        return Polynomial([1.0, *self.radial])

    @property
    def _denominator(self) -> Polynomial:
        return Polynomial([1.0, *self.divisor])


@lru_cache(maxsize=64)
def undistorted_bounds(
    lens: Distortion,
    limit: float,
    focal: tuple[float, float],
    center: tuple[float, float],
    size: tuple[int, int],
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the least and the greatest undistorted points of an image, whose border has them.

    Args:
        lens: The lens.
        limit: The greatest undistorted radius.
        focal: Focal lengths, in pixels.
        center: Principal point, in pixels.
        size: Width and height, in pixels.
    """
    # Beside the principal point is what a barrel shows most of; in corners, what a cushion does.
    (width, height), (cx, cy) = size, center
    x = np.append(np.linspace(0, width, _BORDER_POINTS), np.clip(cx, 0, width))
    y = np.append(np.linspace(0, height, _BORDER_POINTS), np.clip(cy, 0, height))
    edges = np.zeros(1), np.full(1, float(width)), np.full(1, float(height))
    sides = [(x, edges[0]), (x, edges[2]), (edges[0], y), (edges[1], y)]
    border = [np.stack(np.broadcast_arrays(columns, rows), -1) for columns, rows in sides]
    points = lens.undistorted((np.concatenate(border) - center) / focal, limit)
    return tuple(points.min(axis=0).tolist()), tuple(points.max(axis=0).tolist())


def _is_finite(value: object) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) <= _LARGEST_COEFFICIENT  # type: ignore[arg-type]


@lru_cache(maxsize=256)
def _fold_radius(lens: Distortion, limit: float) -> float:
    # Step 1: find the first of many radii, even in the angle, at which the lens folds.
    count = _DIRECTIONS if any((*lens.tangential, *lens.prism)) else 1
    angles = np.arange(count) * 2 * np.pi / count
    directions = np.stack([np.cos(angles), np.sin(angles)], -1)
    radii = np.tan(np.linspace(0, math.atan(limit), _SEARCH_RADII))
    is_folded = _folds_at(lens, radii, directions)
    if not is_folded.any():
        return limit
    # Step 2: halve the interval before it.
    last = int(is_folded.argmax())
    low, high = float(radii[last - 1]), float(radii[last])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if _folds_at(lens, np.array([middle]), directions)[0]:
            high = middle
        else:
            low = middle
    return low


def _folds_at(lens: Distortion, radii: np.ndarray, directions: Points) -> np.ndarray:
    """Return whether the derivative's determinant, or the divisor, is not positive at radii."""
    points = (radii[:, None, None] * directions).reshape(-1, 2)
    with np.errstate(all="ignore"):  # a radius may be that of a pole
        (uu, vu), (uv, vv) = lens.jacobian(points).T
        determinant = (uu * vv - uv * vu).reshape(len(radii), len(directions))
        is_valid = (determinant > 0).all(axis=1) & (lens._denominator(radii * radii) > 0)
    return np.asarray(~is_valid)
