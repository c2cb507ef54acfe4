"""Morton codes of positions in a cube, and the octree cells that prefixes of codes name.

G. M. Morton 1966, "A computer oriented geodetic data base": the bits of the coordinates,
interleaved. A cell at depth d of the octree is the first 3d bits of the codes of its points, so
that sorting by code makes every cell of every depth a contiguous run.
"""

__all__ = ["DEPTH", "Cube", "cell_codes", "morton_codes", "separation_depths"]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float, Float64, Int64, UInt64

from gsgen.formats.shared.morton import interleave_bits

DEPTH: Final = 21
"""Bits of a code along each axis, and the deepest level of the octree."""

_CELLS_PER_SIDE: Final = 1 << DEPTH


@final
@dataclass(frozen=True, slots=True)
class Cube:
    """An axis-aligned cube, such as the root cell of an octree.

    Attributes:
        low: The corner with the least coordinates, in scene units.
        side: Length of an edge, in scene units; above 0.
    """

    low: tuple[float, float, float]
    side: float

    @classmethod
    def enclosing(cls, low: Float64[np.ndarray, "3"], high: Float64[np.ndarray, "3"]) -> "Cube":
        """Return a cube around an axis-aligned box, with the same centre.

        The side is a little longer than the box, and never shorter than float64 can divide.
        """
        center = (low + high) / 2
        max_coordinate = float(np.abs([low, high]).max())
        side = max(float((high - low).max()), max_coordinate * 1e-9, 1e-9) * (1 + 1e-9)
        low_corner = center - side / 2
        return cls((float(low_corner[0]), float(low_corner[1]), float(low_corner[2])), side)

    def cell(self, depth: int, prefix: int) -> "Cube":
        """Return the octree cell whose Morton codes begin with the given bits."""
        index = [0, 0, 0]
        for bit in range(depth):
            for axis in range(3):
                index[axis] |= (prefix >> (3 * bit + axis) & 1) << bit
        side = self.side / (1 << depth)
        x, y, z = (self.low[axis] + index[axis] * side for axis in range(3))
        return Cube((x, y, z), side)

    @property
    def center(self) -> Float64[np.ndarray, "3"]:
        """The centre of the cube."""
        return np.asarray(self.low) + self.side / 2


def morton_codes(position: Float[np.ndarray, "n 3"], cube: Cube) -> UInt64[np.ndarray, " n"]:
    """Return the 63-bit Morton codes of positions in ``cube``; x has the lowest bit.

    Positions beyond the cube have the code of its nearest cell.
    """
    share = (position.astype(np.float64) - np.asarray(cube.low)) / cube.side
    cells = np.clip(np.floor(share * _CELLS_PER_SIDE), 0, _CELLS_PER_SIDE - 1).astype(np.uint64)
    return interleave_bits(*cells.T)


def cell_codes(codes: UInt64[np.ndarray, " n"], depth: int) -> UInt64[np.ndarray, " n"]:
    """Return the octree cells at ``depth`` of Morton codes: their first 3 ``depth`` bits."""
    return np.asarray(codes >> np.uint64(3 * (DEPTH - depth)))


def separation_depths(codes: UInt64[np.ndarray, " n"]) -> Int64[np.ndarray, " m"]:
    """Return the octree depth at which each sorted Morton code leaves its predecessor's cell.

    Returns:
        For rows 1 … n−1, the least depth at which the row and its predecessor are in different
        cells; DEPTH + 1 where they never are.
    """
    difference = codes[1:] ^ codes[:-1]
    # The position of the highest bit, from float64's exponent; rounding up to the next power
    # of two would shift it, so the lower bits are cleared first.
    high = (difference >> np.uint64(32)).astype(np.int64)
    low = (difference & np.uint64(0xFFFFFFFF)).astype(np.int64)
    bits = np.where(high > 0, np.frexp(high.astype(np.float64))[1] + 32, 0)
    bits = np.where(high > 0, bits, np.frexp(low.astype(np.float64))[1])
    return np.asarray(DEPTH + 1 - (bits + 2) // 3, np.int64)
