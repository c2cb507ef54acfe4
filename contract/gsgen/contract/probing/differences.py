"""Differences of arrays that may hold NaN and infinity."""

__all__ = ["largest_difference", "paired_blocks", "signed_difference"]

from collections.abc import Iterator

import numpy as np

_BLOCK_ELEMENTS = (
    1 << 20
)  # elements at a time: copies in float64 would take several times the outputs


def largest_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest absolute difference of two output arrays; infinite if shapes differ."""
    if a.shape != b.shape:
        return float("inf")
    blocks = paired_blocks(a, b)
    return max((_max_abs(signed_difference(x, y)) for x, y in blocks), default=0.0)


def signed_difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a − b in float64, with zero for equal infinities and for two NaN."""
    x, y = a.astype(np.float64), b.astype(np.float64)
    is_equal = (x == y) | (np.isnan(x) & np.isnan(y))
    with np.errstate(invalid="ignore"):  # infinity less infinity
        return np.asarray(np.where(is_equal, 0.0, x - y))


def paired_blocks(a: np.ndarray, b: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield blocks of two arrays of one shape, whose copies need little memory."""
    x, y = a.reshape(-1), b.reshape(-1)
    for start in range(0, a.size, _BLOCK_ELEMENTS):
        yield x[start : start + _BLOCK_ELEMENTS], y[start : start + _BLOCK_ELEMENTS]


def _max_abs(difference: np.ndarray) -> float:
    sizes = np.abs(difference)
    return float(np.where(np.isnan(sizes), np.inf, sizes).max(initial=0.0))
