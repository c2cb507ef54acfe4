"""Morton order of points, which stores neighbours in space near each other in a file."""

import numpy as np
from jaxtyping import Float32, Int64, Integer, UInt64

_AXIS_BITS = 10
_CHUNK_ROWS = 1 << 18
_MAX_CELL = (1 << _AXIS_BITS) - 1
_BIT_SPREAD_STEPS = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
"""The shifts and masks that move apart halves, quarters, … of 21 bits."""


def morton_order(position: Float32[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Return the row order that sorts positions along a Morton curve in their bounding box.

    The box has 1024 cells a side. Rows of the same cell keep their order.
    """
    position64 = position.astype(np.float64)
    low, high = position64.min(axis=0), position64.max(axis=0)
    size = np.where(high > low, high - low, 1.0)
    return grid_order(np.rint((position64 - low) / size * _MAX_CELL).astype(np.uint32))


def grid_order(cells: Integer[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Return the row order that sorts integer grid cells (below 2²¹) along a Morton curve.

    Rows of the same cell keep their order.
    """
    return np.argsort(grid_codes(cells), kind="stable")


def grid_codes(cells: Integer[np.ndarray, "n 3"]) -> UInt64[np.ndarray, " n"]:
    """Return the place of integer grid cells (below 2²¹) on a Morton curve.

    G. M. Morton 1966, "A computer oriented geodetic data base": the bits of the coordinates,
    interleaved, are the index on the curve.
    """
    codes = np.zeros(len(cells), np.uint64)
    for start in range(0, len(cells), _CHUNK_ROWS):
        x, y, z = cells[start : start + _CHUNK_ROWS].T.astype(np.uint64)
        codes[start : start + _CHUNK_ROWS] = interleave_bits(z, y, x)
    return codes


def interleave_bits(
    x: UInt64[np.ndarray, "..."], y: UInt64[np.ndarray, "..."], z: UInt64[np.ndarray, "..."]
) -> UInt64[np.ndarray, "..."]:
    """Return the Morton codes of coordinates of 21 bits each; ``x`` has the lowest of three bits."""
    return np.asarray(
        _spread_bits(x) | _spread_bits(y) << np.uint64(1) | _spread_bits(z) << np.uint64(2)
    )


def _spread_bits(number: UInt64[np.ndarray, "..."]) -> UInt64[np.ndarray, "..."]:
    """Insert two zero bits between the bits of each number of 21 bits."""
    for shift, mask in _BIT_SPREAD_STEPS:
        number = (number | (number << np.uint64(shift))) & np.uint64(mask)
    return number
