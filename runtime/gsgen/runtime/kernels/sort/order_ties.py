"""Sorts splats of equal float32 depth by the depth's rounding error, then by splat set."""

__all__ = ["MAX_TIED_KEYS", "OrderTies"]

from typing import Final, final

from gsgen.runtime.gpu.device import MAX_WORKGROUPS, Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.sizes import symbolic_max
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS
from gsgen.runtime.kernels.shared.kernel import Kernel, Step
from gsgen.runtime.kernels.tiles.bin_tiles import WALK_THREADS

MAX_TIED_KEYS: Final = 64
"""Most splats of equal keys that the kernel sorts; for longer ties the sort is repeated."""


@final
class OrderTies:
    """The kernel ``order_ties.wgsl``, which sorts splats of equal depth keys exactly.

    Args:
        device: Device of the kernel.
        walk_rows: Splats per invocation.
        is_reordered: Whether the order of splats in memory differs from that of their sets.
    """

    def __init__(self, device: Device, walk_rows: int, *, is_reordered: bool) -> None:
        self._block_rows = WALK_THREADS * walk_rows
        self.kernel = Kernel(
            device,
            "order_ties",
            "order_ties",
            ("wrrwr",),
            THREADS=WALK_THREADS,
            RUN=walk_rows,
            MOST_TIED=MAX_TIED_KEYS,
            ARRANGED=is_reordered,
            **COUNT_CONSTANTS,
        )

    def step(
        self,
        capacity: int,
        counts: Buffer,
        keys: Buffer,
        low_keys: Buffer,
        order: Buffer,
        *origins: Buffer,
    ) -> Step:
        """Return the dispatch that sorts splats of equal depth keys.

        Args:
            capacity: Most splats.
            counts: The frame's counts.
            keys: Keys of the visible splats, in ascending order.
            low_keys: Remainder of each splat's depth beyond its key, as bits that sort alike.
            order: The sorted splats.
            origins: If ``is_reordered``, the index of each splat in the order of the sets.
        """
        if not origins:
            origins = (low_keys,)  # a buffer has to be bound, but is not read
        bind = self.kernel.bind(counts, keys, low_keys, order, *origins)
        # A direct dispatch: the kernel writes the counts, so they cannot be its indirect arguments.
        groups = symbolic_max(-(-capacity // self._block_rows), 1)
        lines = -(-groups // MAX_WORKGROUPS)
        return Step(self.kernel, (bind,), (-(-groups // lines), lines, 1))
