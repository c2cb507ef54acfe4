"""Finds the range of each tile in the sorted list of splat-tile pairs."""

__all__ = ["RANGE_BLOCK", "TileRanges", "ranges_reference"]

from typing import Final, final

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS, Counts
from gsgen.runtime.kernels.shared.kernel import Kernel, Step

_THREADS: Final = 128
_RUN: Final = 16
RANGE_BLOCK: Final = _THREADS * _RUN
"""Pairs per workgroup, so large that the dispatch limit covers all pairs of a binding."""


@final
class TileRanges:
    """The kernel ``tile_ranges.wgsl``, which finds the splat-tile pairs of each image tile."""

    def __init__(self, device: Device) -> None:
        self.kernel = Kernel(
            device, "tile_ranges", "mark", ("rrw",), THREADS=_THREADS, RUN=_RUN, **COUNT_CONSTANTS
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


def ranges_reference(tiles: UInt32[np.ndarray, " n"], count: int) -> UInt32[np.ndarray, "t 2"]:
    """Return the range of splat-tile pairs of each tile: the reference of ``tile_ranges.wgsl``."""
    tile_ids = np.arange(count)
    ends = [np.searchsorted(tiles, tile_ids, side) for side in ("left", "right")]
    bounds = np.stack(ends, axis=1)
    return np.where(bounds[:, :1] < bounds[:, 1:], bounds, 0).astype(np.uint32)
