"""The counts of a frame, which stay on the GPU: their indices, and arguments of indirect dispatches.

Kernels get the indices as constants of the same names.
"""

__all__ = ["BYTES", "COUNT_CONSTANTS", "Counts"]

from enum import IntEnum
from typing import Final

import numpy as np
from jaxtyping import UInt32


class Counts(IntEnum):
    """Index of each count, in words of four bytes.

    A name that ends in ``_GROUPS`` begins three words: the arguments of an indirect dispatch.
    """

    GAUSSIANS = 0
    """Gaussians of the scene, drawn or not."""
    VISIBLE = 1
    """Splats that are drawn."""
    PAIRS = 2
    """Pairs of a splat and a tile that it touches, limited to PAIR_CAPACITY."""
    WANTED_PAIRS = 3
    """The same without that limit."""
    PAIR_CAPACITY = 4
    DRAWN = 5
    """Gaussians of the drawn cells, for weighted sums."""
    TIED = 6
    """1 if more splats share one depth than the tie pass puts in the order of their sets."""
    UNSORTED = 7
    """1 if more splats share one key than the tie pass orders by the rest of their depths."""
    SORT_VISIBLE_GROUPS = 8
    WALK_VISIBLE_GROUPS = 12
    SORT_PAIRS_GROUPS = 16
    WALK_PAIRS_GROUPS = 20
    DRAW_ARGUMENTS = 24
    """Four words: vertices, instances, and the first of each."""


BYTES: Final = 4 * 28
COUNT_CONSTANTS: Final = {member.name: int(member) for member in Counts}
"""The indices as constants for a shader."""


def initial(
    gaussians: int, pair_capacity: int, *, panorama: bool = False
) -> UInt32[np.ndarray, " 28"]:
    """Return the counts before the first frame."""
    counts = np.zeros(BYTES // 4, np.uint32)
    counts[Counts.GAUSSIANS] = gaussians
    counts[Counts.PAIR_CAPACITY] = pair_capacity
    for member in Counts:
        if member.name.endswith("_GROUPS"):
            counts[member + 1 : member + 3] = 1
    # A quad is a strip of two triangles; a panorama has three, with two corners at each joint.
    counts[Counts.DRAW_ARGUMENTS] = 16 if panorama else 4
    return counts
