"""The counters of a frame in a GPU buffer, including arguments of indirect dispatches.

Kernels get their indices as constants of the same names.
"""

__all__ = ["COUNTERS_BYTES", "COUNT_CONSTANTS", "Counts"]

from enum import IntEnum
from typing import Final

import numpy as np
from jaxtyping import UInt32


class Counts(IntEnum):
    """Index of each counter of a frame in the GPU buffer of counters, in words of four bytes.

    A name that ends in ``_GROUPS`` begins three words: the arguments of an indirect dispatch.
    """

    GAUSSIANS = 0
    """Gaussians of the scene, drawn or not."""
    VISIBLE = 1
    """Drawn splats."""
    PAIRS = 2
    """Pairs of a splat and a tile that it touches, limited to PAIR_CAPACITY."""
    WANTED_PAIRS = 3
    """Pairs of a splat and a tile that it touches, without the limit."""
    PAIR_CAPACITY = 4
    DRAWN = 5
    """Gaussians of the drawn cells (groups of Gaussians), for weighted sums."""
    TIED = 6
    """1 if more splats share one depth than the tie pass can sort by their sets."""
    UNSORTED = 7
    """1 if more splats share one key than the tie pass can sort by their depth remainders."""
    SORT_VISIBLE_GROUPS = 8
    WALK_VISIBLE_GROUPS = 12
    SORT_PAIRS_GROUPS = 16
    WALK_PAIRS_GROUPS = 20
    DRAW_ARGUMENTS = 24
    """The arguments of an indirect draw: vertices, instances, and the first of each."""


COUNTERS_BYTES: Final = 4 * 28
COUNT_CONSTANTS: Final = {member.name: int(member) for member in Counts}
"""The indices of the counters as constants for a shader."""


def initial(
    gaussians: int, pair_capacity: int, *, panorama: bool = False
) -> UInt32[np.ndarray, " 28"]:
    """Return the initial values of a frame's counters, as stored in the GPU buffer of counters."""
    counts = np.zeros(COUNTERS_BYTES // 4, np.uint32)
    counts[Counts.GAUSSIANS] = gaussians
    counts[Counts.PAIR_CAPACITY] = pair_capacity
    for member in Counts:
        if member.name.endswith("_GROUPS"):
            counts[member + 1 : member + 3] = 1
    # A quad is a strip of two triangles; a panorama has three, with two corners at each joint.
    counts[Counts.DRAW_ARGUMENTS] = 16 if panorama else 4
    return counts
