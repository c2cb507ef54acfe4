"""Morton order of points, which places neighbours in space next to each other in a file."""

import numpy as np
from jaxtyping import Float32, Int64, UInt32

_BITS = 10
_LAST = (1 << _BITS) - 1


def morton_order(position: Float32[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Return the order of the rows of ``position`` along Morton's curve in their box.

    G. M. Morton 1966, "A computer oriented geodetic data base": the bits of the coordinates,
    interleaved, are the index on the curve. Rows of the same cell keep their order.
    """
    position64 = position.astype(np.float64)
    low, high = position64.min(axis=0), position64.max(axis=0)
    size = np.where(high > low, high - low, 1.0)
    cells = np.rint((position64 - low) / size * _LAST).astype(np.uint32)
    x, y, z = (_spread(cells[:, axis]) for axis in range(3))
    return np.argsort(x << 2 | y << 1 | z, kind="stable")


def _spread(cells: UInt32[np.ndarray, " n"]) -> UInt32[np.ndarray, " n"]:
    """Insert two zero bits between the ten bits of each number."""
    cells = (cells | cells << 16) & 0x030000FF
    cells = (cells | cells << 8) & 0x0300F00F
    cells = (cells | cells << 4) & 0x030C30C3
    return np.asarray((cells | cells << 2) & 0x09249249)
