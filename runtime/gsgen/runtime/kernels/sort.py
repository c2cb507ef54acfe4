"""Sort: a stable radix sort of keys with values, and the scan that it needs."""

__all__ = ["Cut", "RadixSort", "Scan", "cut_for"]

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.device import Device
from gsgen.runtime.kernels.counts import PLACES, Counts
from gsgen.runtime.kernels.kernel import Kernel, Step
from gsgen.runtime.kernels.shader import ABSENT

_SLOT: Final = 256
_SCAN_THREADS: Final = 256
KEY_BITS: Final = 32


@final
@dataclass(frozen=True, slots=True)
class Cut:
    """How work is cut into workgroups.

    Attributes:
        threads: Invocations of a workgroup of the sort.
        run: Keys of each.
        digit_bits: Bits that one pass sorts by, at most.
        walk: Sorted splats that one invocation bins.
    """

    threads: int
    run: int
    digit_bits: int
    walk: int

    @property
    def block(self) -> int:
        """Keys of a workgroup."""
        return self.threads * self.run


def cut_for(device: Device) -> Cut:
    """Return the cut that suits a device: a CPU likes long runs, a GPU many invocations."""
    return Cut(8, 512, 8, 64) if device.software else Cut(256, 16, 4, 4)


@final
class Scan:
    """``scan.wgsl``: running sums in place.

    Args:
        device: Where it runs.
        cut: How work is cut.
        walk_block: Splats that a workgroup of the binning has.
        range_block: Pairs that a workgroup of the ranges has.
    """

    def __init__(self, device: Device, cut: Cut, walk_block: int, range_block: int) -> None:
        self._device = device
        self.kernel = Kernel(
            device,
            "scan",
            "scan",
            ("uww",),
            THREADS=_SCAN_THREADS,
            SORT_BLOCK=cut.block,
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
            numbers: What is scanned.
            source: See above.
            block: See above.
            rows: See above.
            total: What the sum of all is to be announced as.
        """
        effect = {None: 0, Counts.VISIBLE: 1, Counts.PAIRS: 2}[total]
        uniform = self._device.uniform("scan", 16)
        self._device.write(uniform, np.array([source, block, rows, effect], np.uint32))
        return Step(self.kernel, (self.kernel.bind(uniform, counts, numbers),), (1, 1, 1))


@final
class RadixSort:
    """``sort.wgsl``: sorts keys with values, least significant digit first.

    Args:
        device: Where it runs.
        cut: How work is cut.
        scan: The scan between counting and scattering.
    """

    def __init__(self, device: Device, cut: Cut, scan: Scan) -> None:
        self._device, self._cut, self._scan = device, cut, scan
        constants = {
            "THREADS": cut.threads,
            "RUN": cut.run,
            "DIGITS": 1 << cut.digit_bits,
        }
        self._count = Kernel(device, "sort", "count", ("urrrwww",), **constants)
        self._scatter = Kernel(device, "sort", "scatter", ("urrrwww",), **constants)

    def histogram(self, capacity: int) -> Any:
        """Return a histogram buffer for sorting up to ``capacity`` keys."""
        size = 4 * (1 << self._cut.digit_bits) * self.blocks(capacity)
        return self._device.storage("histogram", size)

    def blocks(self, capacity: int) -> int:
        """Return how many workgroups ``capacity`` keys take."""
        return max(1, -(-capacity // self._cut.block))

    def steps(
        self,
        counts: Any,
        histogram: Any,
        pairs: list[tuple[Any, Any]],
        *,
        bits: int,
        source: Counts,
        groups: Counts,
        capacity: int | None = None,
        compacted: Counts | None = None,
    ) -> tuple[list[Step], int]:
        """Return the steps of a sort, and which of ``pairs`` holds the result.

        Args:
            counts: The frame's counts.
            histogram: From :meth:`histogram`.
            pairs: Two (keys, values), of which the first holds the input.
            bits: Low bits of the keys to sort by.
            source: The count of keys.
            groups: Where the indirect arguments for as many keys are.
            capacity: If given, the first pass is dispatched for as many keys, its values
                are the keys' places, and keys that are ABSENT are left out.
            compacted: Where the count of keys that are left then goes.
        """
        passes = max(1, -(-bits // self._cut.digit_bits))
        width = -(-bits // passes)
        made: list[Step] = []
        at = 0
        for number in range(passes):
            first = number == 0 and capacity is not None
            now = Counts.GAUSSIANS if first else (compacted or source)
            digits = min(width, bits - number * width)
            uniform = self._device.uniform("digit", 16)
            words = np.array([number * width, digits, now, first], np.uint32)
            self._device.write(uniform, words)
            resources = (uniform, counts, *pairs[at], histogram, *pairs[1 - at])
            dispatch: tuple[int, int, int] | tuple[Any, int] = (counts, 4 * groups)
            if first and capacity is not None:
                dispatch = (self.blocks(capacity), 1, 1)
            made += [
                Step(self._count, (self._count.bind(*resources),), dispatch),
                self._scan.step(
                    counts,
                    histogram,
                    source=now,
                    block=self._cut.block,
                    rows=1 << digits,
                    total=compacted if first else None,
                ),
                Step(self._scatter, (self._scatter.bind(*resources),), dispatch),
            ]
            at = 1 - at
        return made, at


def sort_reference(keys: UInt32[np.ndarray, " n"], bits: int) -> UInt32[np.ndarray, " m"]:
    """What the sort must make of places as values: ABSENT keys left out, equal keys in order."""
    kept = np.flatnonzero(keys != ABSENT)
    order = np.argsort(keys[kept] & ((1 << bits) - 1), kind="stable")
    return kept[order].astype(np.uint32)
