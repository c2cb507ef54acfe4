"""Decomposes covariances of many Gaussians into scales and rotations, by NumPy on all at once."""

__all__ = ["scales_and_quaternions"]

import math
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64

_ROWS: Final = 1 << 13  # at a time, which stay in the cache
# Off-diagonal entries shrink quadratically: four sweeps usually reach float64's rounding.
_SWEEPS: Final = 5
_ORDER: Final = (2, 0, 2)  # the axes about which swaps sort three scales
# Of q = (w, x, y, z), a half turn about an own axis makes (-x, w, z, -y), (-y, -z, w, x) or
# (-z, y, -x, w): the same covariance.
_COMPONENTS: Final = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_SIGNS: Final = np.array([[1, 1, 1, 1], [-1, 1, 1, -1], [-1, -1, 1, 1], [-1, 1, -1, 1.0]])

Column = Float64[np.ndarray, " n"]


def scales_and_quaternions(
    covariance: Float[np.ndarray, "n 6"],
) -> tuple[Float64[np.ndarray, "n 3"], Float32[np.ndarray, "n 4"]]:
    """Decompose covariances into standard deviations and quaternions.

    The scales ascend. Of the quaternions that differ by the signs of two axes, the one with the
    smallest angle is returned. Each row's result depends on the row alone, bit for bit.

    Args:
        covariance: Upper triangles xx xy xz yy yz zz, in squared scene units; finite.

    Returns:
        Scales in scene units, 0 where rounding made an eigenvalue negative; and unit quaternions
        (w, x, y, z) whose w is positive, and the largest component.
    """
    scales = np.empty((len(covariance), 3))
    quaternions = np.empty((len(covariance), 4), np.float32)
    for start in range(0, len(covariance), _ROWS):
        part = slice(start, start + _ROWS)
        variances, turn = _eigenvalues(np.array(covariance[part].T, np.float64, order="C"))
        scales[part] = np.sqrt(np.maximum(variances, 0)).T
        quaternions[part] = _smallest_turn(turn).T
    return scales, quaternions


def _eigenvalues(
    upper: Float64[np.ndarray, "6 n"],
) -> tuple[Float64[np.ndarray, "3 n"], Float64[np.ndarray, "4 n"]]:
    """Return ascending eigenvalues of covariances, and the rotations to their eigenvectors.

    Jacobi's method (1846): each turn about an own axis makes the entry of the other two axes zero.
    """
    diagonal = upper[[0, 3, 5]]
    between = upper[[4, 2, 1]]  # between[axis]: the entry of the other two axes
    turn = np.zeros((4, upper.shape[1]))
    turn[0] = 1
    for axis in (0, 1, 2) * _SWEEPS:
        p, q = (axis + 1) % 3, (axis + 2) % 3
        # tan φ = ± 2 b / (|d| + √(d² + 4 b²)): the smaller angle, 0 where there is nothing to do
        twice = 2 * between[axis]
        difference = diagonal[q] - diagonal[p]
        length = np.abs(difference) + np.sqrt(difference * difference + twice * twice)
        tangent = np.copysign(1, difference) * twice / np.where(length > 0, length, 1)
        cosine = 1 / np.sqrt(1 + tangent * tangent)
        sine = tangent * cosine
        shift = tangent * between[axis]
        diagonal[p] -= shift
        diagonal[q] += shift
        between[axis] = 0
        between[q], between[p] = (
            cosine * between[q] - sine * between[p],
            cosine * between[p] + sine * between[q],
        )
        half = np.sqrt((1 + cosine) / 2)
        _turn_about(turn, axis, half, -sine / (2 * half))
    for axis in _ORDER:
        p, q = (axis + 1) % 3, (axis + 2) % 3
        is_swapped = diagonal[p] > diagonal[q]
        diagonal[[p, q]] = np.where(is_swapped, diagonal[[q, p]], diagonal[[p, q]])
        quarter = math.sqrt(0.5)
        _turn_about(turn, axis, np.where(is_swapped, quarter, 1), is_swapped * -quarter)
    return diagonal, turn


def _turn_about(turn: Float64[np.ndarray, "4 n"], axis: int, cosine: Column, sine: Column) -> None:
    """Multiply quaternions from the right by a rotation about an axis, given its half angle."""
    w, r, p, q = turn[[0, 1 + axis, 1 + (axis + 1) % 3, 1 + (axis + 2) % 3]]
    turn[0] = cosine * w - sine * r
    turn[1 + axis] = cosine * r + sine * w
    turn[1 + (axis + 1) % 3] = cosine * p + sine * q
    turn[1 + (axis + 2) % 3] = cosine * q - sine * p


def _smallest_turn(turn: Float64[np.ndarray, "4 n"]) -> Float64[np.ndarray, "4 n"]:
    """Rotate the axes of ellipsoids by half turns until w is the quaternions' largest component."""
    largest = np.abs(turn).argmax(axis=0)
    result = np.take_along_axis(turn, _COMPONENTS[:, largest], axis=0) * _SIGNS.T[:, largest]
    return np.asarray(np.where(result[0] < 0, -result, result))
