"""Where the counts of a frame are: numbers that stay on the GPU, and what is dispatched by them.

Kernels know the places as constants of the same names.
"""

__all__ = ["BYTES", "PLACES", "Counts"]

from enum import IntEnum
from typing import Final

import numpy as np
from jaxtyping import UInt32


class Counts(IntEnum):
    """Index of each count, in words of four bytes.

    A name that ends in ``_GROUPS`` begins three words: the arguments of an indirect dispatch.
    """

    GAUSSIANS = 0
    """In the scene, drawn or not."""
    VISIBLE = 1
    """Splats that are drawn."""
    PAIRS = 2
    """Pairs of a splat and a tile that it touches, no more than there is room for."""
    WANTED_PAIRS = 3
    """The same, room or not."""
    PAIR_CAPACITY = 4
    DRAWN = 5
    """Gaussians of the cells that are drawn, where it is cells that are sorted."""
    TIED = 6
    """Whether more splats are at one depth than are put in order as their sets have them."""
    UNSORTED = 7
    """Whether more splats have one key than are put in order by the rest of their depths."""
    SORT_VISIBLE_GROUPS = 8
    WALK_VISIBLE_GROUPS = 12
    SORT_PAIRS_GROUPS = 16
    WALK_PAIRS_GROUPS = 20
    DRAW_ARGUMENTS = 24
    """Four words: vertices, instances, and the first of each."""


BYTES: Final = 4 * 28
PLACES: Final = {member.name: int(member) for member in Counts}
"""The same as constants for a shader."""


def initial(
    gaussians: int, pair_capacity: int, panorama: bool = False
) -> UInt32[np.ndarray, " 28"]:
    """Return the counts as they are before the first frame."""
    counts = np.zeros(BYTES // 4, np.uint32)
    counts[Counts.GAUSSIANS] = gaussians
    counts[Counts.PAIR_CAPACITY] = pair_capacity
    for member in Counts:
        if member.name.endswith("_GROUPS"):
            counts[member + 1 : member + 3] = 1
    # A quad is a strip of two triangles; a panorama has three, with two corners at each joint.
    counts[Counts.DRAW_ARGUMENTS] = 16 if panorama else 4
    return counts
