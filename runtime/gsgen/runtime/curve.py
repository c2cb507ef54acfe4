"""Orders along a curve: what is near in space comes to be near in memory."""

__all__ = ["along_curve"]

from typing import Final

import numpy as np
from jaxtyping import Float, Int64, UInt64

_BITS: Final = 21  # of each coordinate; three of them fill a word
_LEAST: Final = 1e-30  # of a box that is not one point
# How far the bits of a number are moved, and which are kept, to make room for two others between.
_SPREAD: Final = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def along_curve(position: Float[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Return the order of points along a Z-order curve (Morton 1966) through their bounding box.

    Points that are not finite come first; equal ones stay in order.
    """
    finite = np.isfinite(position).all(axis=1)
    if not finite.any():
        return np.arange(len(position))
    known = position[finite].astype(np.float64)
    low = known.min(axis=0)
    scale = ((1 << _BITS) - 1) / max(float(np.ptp(known, axis=0).max()), _LEAST)
    code = np.zeros(len(position), np.uint64)
    for axis in range(3):
        cell = ((known[:, axis] - low[axis]) * scale).astype(np.uint64)
        code[finite] |= _spread(cell) << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _spread(number: UInt64[np.ndarray, " n"]) -> UInt64[np.ndarray, " n"]:
    """Return numbers of 21 bits with two zeros between their bits."""
    for shift, kept in _SPREAD:
        number = (number | (number << np.uint64(shift))) & np.uint64(kept)
    return number
