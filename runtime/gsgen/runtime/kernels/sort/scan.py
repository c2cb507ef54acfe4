"""Scan: replaces numbers on the GPU by the sums of all before them (prefix sums)."""

__all__ = ["MAX_COUNT", "Scan"]

from functools import cache
from typing import Final, final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS, Counts
from gsgen.runtime.kernels.shared.kernel import Kernel, Step

MAX_COUNT: Final = 0x7FFFFFFF
"""The largest sum: larger ones saturate."""

_THREADS_PER_WORKGROUP: Final = 256
_NUMBERS_PER_THREAD: Final = 8
_BLOCK_NUMBERS: Final = _THREADS_PER_WORKGROUP * _NUMBERS_PER_THREAD
_SCAN_COUNTER_CODES: Final = {None: 0, Counts.VISIBLE: 1, Counts.PAIRS: 2}


@final
class Scan:
    """Exclusive prefix sums: ``scan_step.wgsl``, and ``scan_blocks.wgsl`` for many numbers.

    A CPU scans as fast in one workgroup as in many. On a GPU one workgroup leaves most processors
    idle, so more than a few thousand numbers are summed by blocks, and these sums are scanned.

    Args:
        device: Device of the kernels.
        sort_block: Keys of a workgroup of the sort.
        walk_block: Splats of a workgroup of the binning.
        range_block: Pairs of a workgroup of the tile ranges.
        always_in_blocks: Whether few numbers are summed by blocks, too: the dispatches of a scan
            are then the same for all sizes.
    """

    def __init__(
        self,
        device: Device,
        sort_block: int,
        walk_block: int,
        range_block: int,
        *,
        always_in_blocks: bool = False,
    ) -> None:
        self._device, self._always_in_blocks = device, always_in_blocks
        constants = {
            "SORT_BLOCK": sort_block,
            "WALK_BLOCK": walk_block,
            "RANGE_BLOCK": range_block,
        } | COUNT_CONSTANTS
        self._scan_kernel, self._scan_sums_kernel = (
            cache(
                lambda block_rows=block_rows: Kernel(
                    device,
                    "scan",
                    "scan",
                    ("uww",),
                    THREADS=_THREADS_PER_WORKGROUP,
                    SHARE=block_rows,
                    **constants,
                )
            )
            for block_rows in (1, _BLOCK_NUMBERS)
        )
        self._reduce_kernel, self._add_sums_kernel = (
            cache(
                lambda entry=entry: Kernel(
                    device,
                    "scan_blocks",
                    entry,
                    ("urww",),
                    THREADS=_THREADS_PER_WORKGROUP,
                    RUN=_NUMBERS_PER_THREAD,
                )
            )
            for entry in ("reduce", "spread")
        )

    def steps(
        self,
        counts: Buffer,
        numbers: Buffer,
        *,
        source: Counts,
        block: int,
        rows: int = 1,
        total: Counts | None = None,
    ) -> list[Step]:
        """Return the dispatches that replace numbers in a GPU buffer by prefix sums.

        The size of the buffer ``numbers`` is the capacity; ``total`` names the count that
        receives the sum of all: VISIBLE, PAIRS or None.
        """
        uniform = self._device.uniform("scan", 16)
        uniform_words = np.array([source, block, rows, _SCAN_COUNTER_CODES[total]], np.uint32)
        self._device.write(uniform, uniform_words)
        # Case 1: one workgroup scans all, where more would not be faster.
        blocks = -(-numbers.size // (4 * _BLOCK_NUMBERS))
        if not self._always_in_blocks and (self._device.software or blocks <= 2):
            kernel = self._scan_kernel()
            return [Step(kernel, (kernel.bind(uniform, counts, numbers),), (1, 1, 1))]
        # Case 2: sum each block, scan the sums, and scan within the blocks from there.
        sums = self._device.storage("sums of blocks", 4 * blocks)
        reduce_step, scan_step, add_sums = (
            self._reduce_kernel(),
            self._scan_sums_kernel(),
            self._add_sums_kernel(),
        )
        resources = (uniform, counts, numbers, sums)
        return [
            Step(reduce_step, (reduce_step.bind(*resources),), (blocks, 1, 1)),
            Step(scan_step, (scan_step.bind(uniform, counts, sums),), (1, 1, 1)),
            Step(add_sums, (add_sums.bind(*resources),), (blocks, 1, 1)),
        ]
