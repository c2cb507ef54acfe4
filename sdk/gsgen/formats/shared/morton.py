"""The order in which neighbours in space are neighbours in a file."""

import numpy as np
from jaxtyping import Float32, Int64, UInt32

_BITS = 10
_LAST = (1 << _BITS) - 1


def morton_order(position: Float32[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Return the rows of ``position`` along Morton's curve through their box.

    G. M. Morton 1966, "A computer oriented geodetic data base": the bits of the coordinates,
    interleaved, are the place on the curve. Rows of the same cell keep their order.
    """
    wide = position.astype(np.float64)
    low, high = wide.min(axis=0), wide.max(axis=0)
    size = np.where(high > low, high - low, 1.0)
    cells = np.rint((wide - low) / size * _LAST).astype(np.uint32)
    x, y, z = (_spread(cells[:, axis]) for axis in range(3))
    return np.argsort(x << 2 | y << 1 | z, kind="stable")


def _spread(cells: UInt32[np.ndarray, " n"]) -> UInt32[np.ndarray, " n"]:
    """Put two zeros between the ten bits of each number."""
    cells = (cells | cells << 16) & 0x030000FF
    cells = (cells | cells << 8) & 0x0300F00F
    cells = (cells | cells << 4) & 0x030C30C3
    return np.asarray((cells | cells << 2) & 0x09249249)
