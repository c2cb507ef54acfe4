"""Sorts the drawn splats of a frame by depth, nearest first; each depth is two floats."""

__all__ = ["DepthOrder"]

from functools import cache
from typing import final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import Step
from gsgen.runtime.kernels.sort.gather_keys import GatherKeys
from gsgen.runtime.kernels.sort.order_ties import OrderTies
from gsgen.runtime.kernels.sort.sort import KEY_BITS, Columns, RadixSort, SortConfig


@final
class DepthOrder:
    """Sorts splats by depth: by 32-bit keys, and equal keys by the low parts of the depths.

    A key is the depth rounded to float32. Of a million centres most have a key of their own, and
    the tie pass orders the others. If a tie is longer than MAX_TIED_KEYS, as in a slightly rotated
    plane, the tie pass sets UNSORTED and the frame is drawn again with a deep sort: by the
    remainders first and then, stably, by the keys. That takes twice as long.

    Args:
        device: Device of the kernels.
        sort_config: Configuration of the sort.
        sort: The radix sort.
    """

    def __init__(self, device: Device, sort_config: SortConfig, sort: RadixSort) -> None:
        self._sort = sort
        self._tie_kernel = cache(
            lambda is_reordered: OrderTies(device, sort_config.walk_rows, is_reordered=is_reordered)
        )
        self._gather_kernel = cache(lambda: GatherKeys(device, sort_config.block))

    def steps(
        self,
        capacity: int,
        counts: Buffer,
        columns: tuple[Columns, Columns],
        low_keys: Buffer,
        origins: Buffer | None = None,
        spare_keys: Buffer | None = None,
        *,
        has_histogram: tuple[Buffer, ...] = (),
    ) -> tuple[list[Step], Buffer]:
        """Return the GPU dispatches of a depth sort, and the buffer of splats, nearest first.

        Args:
            capacity: Most splats.
            counts: The frame's counts.
            columns: First the keys of all splats, ABSENT for splats that are not drawn; second a
                scratch pair. Both are overwritten, but a deep sort leaves the keys.
            low_keys: Remainders of the depths beyond the keys, as bits that sort alike; ABSENT for
                splats that are not drawn.
            origins: Index of each splat in the order of the sets; None if splats are in it.
            spare_keys: Scratch buffer for more keys, which makes the sort deep.
            has_histogram: Histograms of the sort, if the kernel that writes the keys has counted their
                first digits there. A deep sort, which begins with the remainders, counts itself.
        """
        histograms = has_histogram or self._sort.histograms(capacity, KEY_BITS)
        if spare_keys is None:
            steps, side = self._sort_by_key(
                capacity, counts, list(columns), histograms, has_histogram=bool(has_histogram)
            )
            sorted_column = columns[side]
        else:
            steps, sorted_column = self._deep_sort_steps(
                capacity, counts, columns, low_keys, spare_keys, histograms
            )
        origin_buffers = () if origins is None else (origins,)
        tie_kernel = self._tie_kernel(bool(origin_buffers))
        keys, order = sorted_column
        return [
            *steps,
            tie_kernel.step(capacity, counts, keys, low_keys, order, *origin_buffers),
        ], order

    def _sort_by_key(
        self,
        capacity: int,
        counts: Buffer,
        columns: list[Columns],
        histograms: tuple[Buffer, ...],
        first_keys: Buffer | None = None,
        *,
        has_histogram: bool = False,
    ) -> tuple[list[Step], int]:
        """Return the dispatches that sort splats by ``first_keys``, or by depth keys if None."""
        return self._sort.steps(
            counts,
            histograms,
            columns,
            bits=KEY_BITS,
            source=Counts.VISIBLE,
            groups=Counts.SORT_VISIBLE_GROUPS,
            compact_counter=capacity,
            first_keys=first_keys,
            has_histogram=has_histogram,
        )

    def _deep_sort_steps(
        self,
        capacity: int,
        counts: Buffer,
        columns: tuple[Columns, Columns],
        low_keys: Buffer,
        spare_keys: Buffer,
        histograms: tuple[Buffer, ...],
    ) -> tuple[list[Step], Columns]:
        """Return the dispatches that sort splats by the depths' low parts, then by depth keys."""
        keys, low_key_columns = columns[0].keys, [columns[0]._replace(keys=spare_keys), columns[1]]
        # Step 1: sort by the remainders, which drops absent splats.
        first, side = self._sort_by_key(
            capacity, counts, low_key_columns, histograms, first_keys=low_keys
        )
        sorted_lows = low_key_columns[side]
        # Step 2: fetch the depth key of each splat in that order.
        gather_step = self._gather_kernel().step(counts, keys, sorted_lows.values, sorted_lows.keys)
        if side:
            low_key_columns.reverse()
        # Step 3: sort by the keys; this sort is stable, so that equal keys keep the order of remainders.
        next_steps, side = self._sort.steps(
            counts,
            histograms,
            low_key_columns,
            bits=KEY_BITS,
            source=Counts.VISIBLE,
            groups=Counts.SORT_VISIBLE_GROUPS,
        )
        return [*first, gather_step, *next_steps], low_key_columns[side]
