"""Finds the range of each tile in the sorted list of splat-tile pairs."""

__all__ = ["RANGE_BLOCK", "TileRanges"]

from typing import Final, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS, Counts
from gsgen.runtime.kernels.shared.kernel import Kernel, Step

_THREADS_PER_WORKGROUP: Final = 128
_PAIRS_PER_THREAD: Final = 16
RANGE_BLOCK: Final = _THREADS_PER_WORKGROUP * _PAIRS_PER_THREAD
"""Pairs per workgroup, so large that the dispatch limit covers all pairs of a binding."""


@final
class TileRanges:
    """The kernel ``tile_ranges.wgsl``, which finds the splat-tile pairs of each image tile."""

    def __init__(self, device: Device) -> None:
        self.kernel = Kernel(
            device,
            "tile_ranges",
            "mark",
            ("rrw",),
            THREADS=_THREADS_PER_WORKGROUP,
            RUN=_PAIRS_PER_THREAD,
            **COUNT_CONSTANTS,
        )

    def step(self, counts: Buffer, tiles: Buffer, ranges: Buffer) -> Step:
        """Return the dispatch that writes the first and the last splat-tile pair of each tile.

        Args:
            counts: The frame's counts.
            tiles: The tile of each pair, in ascending order.
            ranges: Two words per tile, zero before.
        """
        bind = self.kernel.bind(counts, tiles, ranges)
        return Step(self.kernel, (bind,), (counts, 4 * Counts.WALK_PAIRS_GROUPS))
