"""Order ties: splats of one depth stand as their sets have them, wherever they are in memory."""

__all__ = ["MOST_TIED", "OrderTies", "order_ties_reference"]

from typing import Any, Final, final

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.device import Device
from gsgen.runtime.kernels.bin_tiles import WALK_THREADS
from gsgen.runtime.kernels.counts import PLACES
from gsgen.runtime.kernels.kernel import Kernel, Step

MOST_TIED: Final = 64
"""Splats of one depth that are put in order; where there are more, rows are not arranged."""


@final
class OrderTies:
    """``order_ties.wgsl``.

    Args:
        device: Where it runs.
        walk: How many splats an invocation walks along.
    """

    def __init__(self, device: Device, walk: int) -> None:
        self._block = WALK_THREADS * walk
        self.kernel = Kernel(
            device,
            "order_ties",
            "order_ties",
            ("wrrw",),
            THREADS=WALK_THREADS,
            RUN=walk,
            MOST_TIED=MOST_TIED,
            **PLACES,
        )

    def step(self, capacity: int, counts: Any, keys: Any, origins: Any, order: Any) -> Step:
        """Return the ordering.

        Args:
            capacity: For how many splats there is room.
            counts: The frame's counts.
            keys: Of the visible splats, in ascending order.
            origins: Where each splat is by the order of the sets.
            order: The sorted splats.
        """
        bind = self.kernel.bind(counts, keys, origins, order)
        # Not by the counts: what is written by a dispatch cannot say how large it is.
        return Step(self.kernel, (bind,), (max(1, -(-capacity // self._block)), 1, 1))


def order_ties_reference(
    keys: UInt32[np.ndarray, " n"],
    origins: UInt32[np.ndarray, " m"],
    order: UInt32[np.ndarray, " n"],
) -> UInt32[np.ndarray, " n"]:
    """What ``order_ties.wgsl`` must make of ``order`` where no tie is longer than MOST_TIED."""
    return order[np.lexsort((origins[order], keys))]
