"""Scan: replace numbers by the sum of all before them, and announce the total."""

__all__ = ["Scan", "scan_reference"]

from typing import Any, Final, final

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.device import Device
from gsgen.runtime.kernels.counts import PLACES, Counts
from gsgen.runtime.kernels.kernel import Kernel, Step

_THREADS: Final = 256
_EFFECTS: Final = {None: 0, Counts.VISIBLE: 1, Counts.PAIRS: 2}


@final
class Scan:
    """``scan.wgsl``.

    Args:
        device: Where it runs.
        sort_block: Keys that a workgroup of the sort has.
        walk_block: Splats that a workgroup of the binning has.
        range_block: Pairs that a workgroup of the ranges has.
    """

    def __init__(
        self, device: Device, sort_block: int, walk_block: int, range_block: int
    ) -> None:
        self._device = device
        self.kernel = Kernel(
            device,
            "scan",
            "scan",
            ("uww",),
            THREADS=_THREADS,
            SORT_BLOCK=sort_block,
            WALK_BLOCK=walk_block,
            RANGE_BLOCK=range_block,
            **PLACES,
        )

    def step(
        self,
        counts: Any,
        numbers: Any,
        *,
        source: Counts,
        block: int,
        rows: int = 1,
        total: Counts | None = None,
    ) -> Step:
        """Return the scan of rows × ⌈counts[source] / block⌉ numbers.

        Args:
            counts: The frame's counts.
            numbers: What is scanned, in place.
            source: Which count the length follows from.
            block: See above.
            rows: See above.
            total: What the sum of all is announced as: VISIBLE, PAIRS or nothing.
        """
        uniform = self._device.uniform("scan", 16)
        words = np.array([source, block, rows, _EFFECTS[total]], np.uint32)
        self._device.write(uniform, words)
        return Step(self.kernel, (self.kernel.bind(uniform, counts, numbers),), (1, 1, 1))


def scan_reference(numbers: UInt32[np.ndarray, " n"]) -> UInt32[np.ndarray, " n"]:
    """What ``scan.wgsl`` must leave: sums stop at 2³¹ − 1 instead of wrapping around."""
    before = np.cumsum(numbers, dtype=np.uint64) - numbers
    return np.asarray(np.minimum(before, 0x7FFFFFFF), np.uint32)
