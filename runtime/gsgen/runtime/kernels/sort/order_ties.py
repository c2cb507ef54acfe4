"""Order ties: splats of one key stand by the rest of their depths, then by their sets."""

__all__ = ["MOST_TIED", "OrderTies", "order_ties_reference"]

from typing import Any, Final, final

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.gpu.device import MOST_GROUPS, Device
from gsgen.runtime.kernels.shared.counts import PLACES
from gsgen.runtime.kernels.shared.kernel import Kernel, Step
from gsgen.runtime.kernels.tiles.bin_tiles import WALK_THREADS

MOST_TIED: Final = 64
"""Splats of one key that are put in order; where there are more, that is left to the sort."""


@final
class OrderTies:
    """``order_ties.wgsl``.

    Args:
        device: Where it runs.
        walk: How many splats an invocation walks along.
        arranged: Whether splats are elsewhere in memory than their sets have them.
    """

    def __init__(self, device: Device, walk: int, arranged: bool) -> None:
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
            **PLACES,
        )

    def step(
        self, capacity: int, counts: Any, keys: Any, lows: Any, order: Any, *origins: Any
    ) -> Step:
        """Return the ordering.

        Args:
            capacity: For how many splats there is room.
            counts: The frame's counts.
            keys: Of the visible splats, in ascending order.
            lows: What the key of each splat leaves of its depth, as bits that sort as it does.
            order: The sorted splats.
            origins: Where rows are arranged, where each splat is by the order of the sets.
        """
        if not origins:
            origins = (lows,)  # something has to be bound, and is not read
        bind = self.kernel.bind(counts, keys, lows, order, *origins)
        # Not by the counts: what is written by a dispatch cannot say how large it is.
        groups = max(1, -(-capacity // self._block))
        lines = -(-groups // MOST_GROUPS)
        return Step(self.kernel, (bind,), (-(-groups // lines), lines, 1))


def order_ties_reference(
    keys: UInt32[np.ndarray, " n"],
    lows: UInt32[np.ndarray, " m"],
    origins: UInt32[np.ndarray, " m"],
    order: UInt32[np.ndarray, " n"],
) -> UInt32[np.ndarray, " n"]:
    """What ``order_ties.wgsl`` must make of ``order`` where no tie is longer than MOST_TIED."""
    return order[np.lexsort((origins[order], lows[order], keys))]
