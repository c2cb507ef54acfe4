"""Decomposes covariances of many Gaussians into scales and rotations, by NumPy on all at once."""

__all__ = ["scales_and_quaternions"]

from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64

_ROWS: Final = 1 << 14  # at a time, which stay in the cache
# Off-diagonal entries shrink quadratically: of random rows in float32, one in twenty needs a fourth
# sweep. More than six were never needed.
_SWEEPS: Final = 3
_MOST_SWEEPS: Final = 12
_NEGLIGIBLE: Final = 1e-3  # of the rounding of the trace: what may be left off the diagonal
_TINY: Final = float(np.finfo(np.float64).tiny)
_ORDER: Final = (2, 0, 2)  # the axes about which swaps sort three scales

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
    scratch = np.empty((4, min(_ROWS, len(covariance))))
    for start in range(0, len(covariance), _ROWS):
        part = slice(start, start + _ROWS)
        state = _diagonalised(covariance[part], scratch)
        _sort(state, scratch[:, : state.shape[1]])
        scales[part] = np.sqrt(np.maximum(state[:3], 0)).T
        quaternions[part] = _smallest_turn(state[6:]).T
    return scales, quaternions


def _diagonalised(
    covariance: Float[np.ndarray, "n 6"], scratch: Float64[np.ndarray, "4 m"]
) -> Float64[np.ndarray, "10 n"]:
    """Return eigenvalues, and eigenvectors as quaternions, of 3×3 covariances.

    Jacobi's method (1846): each turn about an own axis makes the entry of the other two axes zero.
    Rows 3 to 5 of the result become zeros; the quaternions are not normalised.
    """
    count = len(covariance)
    state = np.zeros((10, count))  # three on the diagonal, yz xz xy, w x y z
    state[:6] = covariance.T[[0, 3, 5, 4, 2, 1]]
    state[6] = 1
    limit = _NEGLIGIBLE * float(np.finfo(covariance.dtype).eps) * np.abs(state[:3]).sum(axis=0)
    for _ in range(_SWEEPS):
        _sweep(state, scratch[:, :count])
    for _ in range(_SWEEPS, _MOST_SWEEPS):
        between = np.abs(state[3:6]).max(axis=0)
        unfinished = np.flatnonzero(between > limit)
        if not unfinished.size:
            break
        columns = state[:, unfinished]
        _sweep(columns, scratch[:, : unfinished.size])
        state[:, unfinished] = columns
    return state


def _sweep(state: Float64[np.ndarray, "10 n"], scratch: Float64[np.ndarray, "4 n"]) -> None:
    """Apply one Jacobi rotation about each axis to covariance matrices, in place.

    New arrays would take longer.
    """
    diagonal, between, turn = state[:3], state[3:6], state[6:]
    first, tangent, length, second = scratch
    for axis in range(3):
        p, q = (axis + 1) % 3, (axis + 2) % 3
        # tan φ = ± 2 b / (|d| + √(d² + 4 b²)): the smaller angle, 0 where there is nothing to do
        difference = np.subtract(diagonal[q], diagonal[p], out=first)
        twice = np.add(between[axis], between[axis], out=tangent)
        np.multiply(difference, difference, out=length)
        length += np.multiply(twice, twice, out=second)
        np.sqrt(length, out=length)
        length += np.abs(difference, out=second)
        np.maximum(length, _TINY, out=length)
        np.divide(twice, np.copysign(length, difference, out=length), out=tangent)
        shift = np.multiply(tangent, between[axis], out=length)
        diagonal[p] -= shift
        diagonal[q] += shift
        between[axis] = 0
        secant = np.multiply(tangent, tangent, out=length)
        secant += 1
        np.sqrt(secant, out=secant)
        np.multiply(tangent, between[p], out=first)
        np.multiply(tangent, between[q], out=second)
        between[q] -= first
        between[p] += second
        between[q] /= secant
        between[p] /= secant
        secant += 1
        _turn_about(turn, axis, np.divide(tangent, secant, out=tangent), scratch)


def _turn_about(
    turn: Float64[np.ndarray, "4 n"],
    axis: int,
    tangent: Column,
    scratch: Float64[np.ndarray, "4 n"],
) -> None:
    """Rotate quaternions by −θ about one of their own axes; ``tangent`` is tan(θ / 2).

    The right factor is 1 − tan(θ / 2) e, for axis e; the product is not normalised.
    ``tangent`` may be the second column of ``scratch``.
    """
    first, _, second, _ = scratch
    w, r, p, q = (turn[index] for index in (0, *(1 + (axis + step) % 3 for step in range(3))))
    for a, b in ((w, r), (q, p)):
        np.multiply(tangent, b, out=first)
        np.multiply(tangent, a, out=second)
        a += first
        b -= second


def _sort(state: Float64[np.ndarray, "10 n"], scratch: Float64[np.ndarray, "4 n"]) -> None:
    """Sort eigenvalues in place by swaps of two axes, which are quarter turns about the third."""
    for axis in _ORDER:
        low, high = state[(axis + 1) % 3], state[(axis + 2) % 3]
        smaller, is_swapped = scratch[:2]
        np.greater(low, high, out=is_swapped, casting="unsafe")  # 0 or 1: tan 0° or tan 45°
        np.minimum(low, high, out=smaller)
        np.maximum(low, high, out=high)
        low[:] = smaller
        _turn_about(state[6:], axis, is_swapped, scratch)


def _smallest_turn(turn: Float64[np.ndarray, "4 n"]) -> Float64[np.ndarray, "4 n"]:
    """Rotate the axes of ellipsoids by half turns until w is the quaternions' largest component.

    Half turns about own axes keep the covariance. The quaternions are normalised.
    """
    w, x, y, z = turn
    # 1. Where y or z is the largest, a half turn about y makes it w or x.
    length = np.abs(turn)
    is_far = np.maximum(length[2], length[3]) > np.maximum(length[0], length[1])
    w, x, y, z = (np.where(is_far, *pair) for pair in ((-y, w), (-z, x), (w, y), (x, z)))
    # 2. Where x is larger than w, a half turn about x exchanges them.
    is_far = np.abs(x) > np.abs(w)
    w, x, y, z = (np.where(is_far, *pair) for pair in ((-x, w), (w, x), (z, y), (-y, z)))
    scale = np.copysign(1 / np.sqrt(w * w + x * x + y * y + z * z), w)
    return np.asarray((w * scale, x * scale, y * scale, z * scale))
