"""Order ties: sort splats of equal keys by the rest of their depths, then by their sets."""

__all__ = ["MOST_TIED", "OrderTies", "order_ties_reference"]

from typing import Final, final

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.gpu.device import MOST_GROUPS, Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS
from gsgen.runtime.kernels.shared.kernel import Kernel, Step
from gsgen.runtime.kernels.tiles.bin_tiles import WALK_THREADS

MOST_TIED: Final = 64
"""The longest tie that the kernel puts in order; the sort is repeated for longer ones."""


@final
class OrderTies:
    """``order_ties.wgsl``.

    Args:
        device: Where it runs.
        walk: How many splats an invocation walks along.
        arranged: Whether splats are elsewhere in memory than their sets have them.
    """

    def __init__(self, device: Device, walk: int, *, arranged: bool) -> None:
        self._block = WALK_THREADS * walk
        self.kernel = Kernel(
            device,
            "order_ties",
            "order_ties",
            ("wrrwr",),
            THREADS=WALK_THREADS,
            RUN=walk,
            MOST_TIED=MOST_TIED,
            ARRANGED=arranged,
            **COUNT_CONSTANTS,
        )

    def step(
        self,
        capacity: int,
        counts: Buffer,
        keys: Buffer,
        lows: Buffer,
        order: Buffer,
        *origins: Buffer,
    ) -> Step:
        """Return the ordering.

        Args:
            capacity: Number of splats that there is room for.
            counts: The frame's counts.
            keys: Of the visible splats, in ascending order.
            lows: Remainder of each splat's depth beyond its key, as bits that sort alike.
            order: The sorted splats.
            origins: Where rows are arranged, where each splat is by the order of the sets.
        """
        if not origins:
            origins = (lows,)  # something has to be bound, and is not read
        bind = self.kernel.bind(counts, keys, lows, order, *origins)
        # A direct dispatch: the kernel writes the counts, so they cannot be its indirect arguments.
        groups = max(1, -(-capacity // self._block))
        lines = -(-groups // MOST_GROUPS)
        return Step(self.kernel, (bind,), (-(-groups // lines), lines, 1))


def order_ties_reference(
    keys: UInt32[np.ndarray, " n"],
    lows: UInt32[np.ndarray, " m"],
    origins: UInt32[np.ndarray, " m"],
    order: UInt32[np.ndarray, " n"],
) -> UInt32[np.ndarray, " n"]:
    """Return ``order`` as ``order_ties.wgsl`` must sort it if no tie is longer than MOST_TIED."""
    return order[np.lexsort((origins[order], lows[order], keys))]
