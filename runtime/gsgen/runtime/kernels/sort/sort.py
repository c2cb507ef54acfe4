"""A stable radix sort of 32-bit keys with values on the GPU."""

__all__ = ["KEY_BITS", "Columns", "RadixSort", "SortConfig", "sort_config_for"]

from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.sizes import symbolic_max
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.first_digits import FirstDigits
from gsgen.runtime.kernels.shared.kernel import Dispatch, Kernel, Step
from gsgen.runtime.kernels.shared.shader import LARGE_TILE, TILE
from gsgen.runtime.kernels.sort.scan import MAX_COUNT, Scan

KEY_BITS: Final = 32
"""Bits of a depth key: positive floats sort like their bits."""


class Columns(NamedTuple):
    """A buffer of sort keys and a buffer of values that are sorted together."""

    keys: Buffer
    values: Buffer


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SortConfig:
    """How radix sort, tile binning and blending of splats are divided among GPU invocations.

    Attributes:
        threads: Invocations of a workgroup of the sort.
        run: Keys per invocation of the sort.
        digit_bits: Most bits that one pass sorts by.
        walk_rows: Sorted splats per invocation of the binning.
        tile: Edge of the tiles that splats are listed by, in pixels.
    """

    threads: int
    run: int
    digit_bits: int
    walk_rows: int
    tile: int

    @property
    def block(self) -> int:
        """The number of sort keys that a workgroup of the GPU radix sort processes."""
        return self.threads * self.run

    @property
    def is_staged(self) -> bool:
        """Whether sort keys are ordered in workgroup memory, by one invocation per digit value."""
        return self.threads >= 1 << self.digit_bits


def sort_config_for(device: Device) -> SortConfig:
    """Return a device's sort settings: many keys per invocation on a CPU, large tiles on a GPU."""
    if device.software:
        return SortConfig(threads=8, run=2048, digit_bits=8, walk_rows=64, tile=TILE)
    return SortConfig(threads=256, run=8, digit_bits=8, walk_rows=4, tile=LARGE_TILE)


@final
class RadixSort:
    """A radix sort, least significant digit first: ``staged_sort.wgsl``, or ``sort.wgsl`` on CPUs.

    Args:
        device: Device of the kernels.
        sort_config: Configuration of the sort.
        scan: The scan between counting and scattering.
    """

    def __init__(self, device: Device, sort_config: SortConfig, scan: Scan) -> None:
        self._device, self._sort_config, self._scan = device, sort_config, scan
        constants = {
            "THREADS": sort_config.threads,
            "RUN": sort_config.run,
            "DIGITS": 1 << sort_config.digit_bits,
        }
        shader, bindings = (
            ("staged_sort", "urrrwwwww") if sort_config.is_staged else ("sort", "urrrwww")
        )
        entries = (
            ("count", "scatter", "scan_rows") if sort_config.is_staged else ("count", "scatter")
        )
        self._kernels = [
            Kernel(device, shader, entry, (bindings,), **constants) for entry in entries
        ]

    def first_digits(self, bits: int) -> FirstDigits:
        """Return what kernels need to count the first digits of the ``bits``-bit keys they write."""
        return FirstDigits(1 << self._radix_digit_width(bits), self._sort_config.block)

    def histograms(self, capacity: int, bits: int) -> tuple[Buffer, ...]:
        """Return new GPU buffers for the digit histograms of a radix sort.

        Args:
            capacity: Most keys.
            bits: Number of low bits of the keys to sort by.

        Returns:
            Of a staged sort two, which passes take by turns, the first pass the first; else one.
        """
        rows = 1 << (
            self._radix_digit_width(bits)
            if self._sort_config.is_staged
            else self._sort_config.digit_bits
        )
        histogram_count = 1 if self._sort_config.is_staged else 1 + self._sort_config.threads
        size = 4 * histogram_count * rows * self.blocks(capacity)
        names = ("histogram a", "histogram b") if self._sort_config.is_staged else ("histogram",)
        return tuple(self._device.storage(name, size) for name in names)

    def blocks(self, capacity: int) -> int:
        """Return the number of GPU workgroups that a radix sort of ``capacity`` keys takes."""
        return symbolic_max(-(-capacity // self._sort_config.block), 1)

    def _radix_digit_width(self, bits: int) -> int:
        """Return the number of bits that each pass but the last sorts by."""
        return -(-bits // -(-bits // self._sort_config.digit_bits))

    def steps(
        self,
        counts: Buffer,
        histograms: tuple[Buffer, ...],
        columns: list[Columns],
        *,
        bits: int,
        source: Counts,
        groups: Counts,
        compact_counter: int | None = None,
        first_keys: Buffer | None = None,
        has_histogram: bool = False,
    ) -> tuple[list[Step], int]:
        """Return the dispatches of a GPU radix sort, and the index of the buffers with the result.

        Args:
            counts: The frame's counts.
            histograms: From :meth:`histograms`, for as many bits.
            columns: The input and a scratch pair; both are overwritten.
            bits: Number of low bits of the keys to sort by.
            source: The count that holds the number of keys.
            groups: The count that begins the arguments of a dispatch for as many keys.
            compact_counter: If given, the first pass reads this many keys, takes their indices as
                values, drops ABSENT keys, and writes the number of the others to ``source``.
            first_keys: Keys that a compacting sort reads in place of those of ``columns``, and
                does not overwrite.
            has_histogram: Whether the kernel that writes the keys has counted their first digits in the
                first histogram, as ``first_digits.wgsl`` does; only for a staged sort.
        """
        pass_count, width = -(-bits // self._sort_config.digit_bits), self._radix_digit_width(bits)
        totals = []
        if self._sort_config.is_staged:
            totals.append(self._device.storage("digit totals", 4 << self._sort_config.digit_bits))
        recorded_steps: list[Step] = []
        for number in range(pass_count):
            # Step 1: a pass sorts by the next digit, stably, so that the digits before stay sorted.
            digits = min(width, bits - number * width)
            next_digits = max(0, min(width, bits - (number + 1) * width))
            first = number == 0 and compact_counter is not None
            # Step 2: a compacting first pass reads all keys; later ones only as many as it kept.
            now = Counts.GAUSSIANS if first else source
            dispatch: Dispatch = (counts, 4 * groups)
            if number == 0 and compact_counter is not None:
                dispatch = (self.blocks(compact_counter), 1, 1)
            uniform_words = [number * width, digits, now, first, next_digits, 1 << width, 0, 0]
            uniform = self._device.uniform("digit", 32)
            self._device.write(uniform, np.array(uniform_words, np.uint32))
            # Step 3: buffers and histograms take turns, so that no pass writes what it reads.
            source_columns, target_columns = columns[number % 2], columns[1 - number % 2]
            if first and first_keys is not None:
                source_columns = Columns(
                    first_keys, first_keys
                )  # a compacting pass reads no values
            histogram_count = (*histograms[number % 2 :], *histograms[: number % 2])
            resources = (
                uniform,
                counts,
                *source_columns,
                *histogram_count,
                *target_columns,
                *totals,
            )
            count, scatter_step, *rows = (
                Step(kernel, (kernel.bind(*resources),), dispatch) for kernel in self._kernels
            )
            # Step 4: count the digits, sum the counts before each, and scatter keys and values.
            # Else the scatter before, or the kernel that writes the keys, has counted.
            if not self._sort_config.is_staged or (number == 0 and not has_histogram):
                recorded_steps.append(count)
            recorded_steps += rows
            if not self._sort_config.is_staged or first:
                recorded_steps += self._scan.steps(
                    counts,
                    totals[0] if self._sort_config.is_staged else histograms[0],
                    source=now,
                    block=MAX_COUNT if self._sort_config.is_staged else self._sort_config.block,
                    rows=1 << digits,
                    total=source if first else None,
                )
            recorded_steps.append(scatter_step)
        return recorded_steps, pass_count % 2
