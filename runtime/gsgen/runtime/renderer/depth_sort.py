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
    the tie pass orders the others. If a tie is longer than MOST_TIED, as in a slightly rotated
    plane, the tie pass sets UNSORTED and the frame is drawn again with a deep sort: by the
    remainders first and then, stably, by the keys. That takes twice as long.

    Args:
        device: Device of the kernels.
        cut: Configuration of the sort.
        sort: The radix sort.
    """

    def __init__(self, device: Device, cut: SortConfig, sort: RadixSort) -> None:
        self._sort = sort
        self._ties = cache(lambda arranged: OrderTies(device, cut.walk, arranged=arranged))
        self._gather = cache(lambda: GatherKeys(device, cut.block))

    def steps(
        self,
        capacity: int,
        counts: Buffer,
        columns: tuple[Columns, Columns],
        lows: Buffer,
        origins: Buffer | None = None,
        spare: Buffer | None = None,
        *,
        counted: tuple[Buffer, ...] = (),
    ) -> tuple[list[Step], Buffer]:
        """Return the GPU dispatches of a depth sort, and the buffer of splats, nearest first.

        Args:
            capacity: Most splats.
            counts: The frame's counts.
            columns: First the keys of all splats, ABSENT for splats that are not drawn; second a
                scratch pair. Both are overwritten, but a deep sort leaves the keys.
            lows: Remainders of the depths beyond the keys, as bits that sort alike; ABSENT for
                splats that are not drawn.
            origins: Index of each splat in the order of the sets; None if splats are in it.
            spare: Scratch buffer for more keys, which makes the sort deep.
            counted: Histograms of the sort, if the kernel that writes the keys has counted their
                first digits there. A deep sort, which begins with the remainders, counts itself.
        """
        histograms = counted or self._sort.histograms(capacity, KEY_BITS)
        if spare is None:
            steps, side = self._by_key(
                capacity, counts, list(columns), histograms, counted=bool(counted)
            )
            sorted_ = columns[side]
        else:
            steps, sorted_ = self._deep(capacity, counts, columns, lows, spare, histograms)
        arranged = () if origins is None else (origins,)
        ties = self._ties(bool(arranged))
        keys, order = sorted_
        return [*steps, ties.step(capacity, counts, keys, lows, order, *arranged)], order

    def _by_key(
        self,
        capacity: int,
        counts: Buffer,
        columns: list[Columns],
        histograms: tuple[Buffer, ...],
        first_keys: Buffer | None = None,
        *,
        counted: bool = False,
    ) -> tuple[list[Step], int]:
        """Return the dispatches that sort splats by ``first_keys``, or by depth keys if None."""
        return self._sort.steps(
            counts,
            histograms,
            columns,
            bits=KEY_BITS,
            source=Counts.VISIBLE,
            groups=Counts.SORT_VISIBLE_GROUPS,
            compacting=capacity,
            first_keys=first_keys,
            counted=counted,
        )

    def _deep(
        self,
        capacity: int,
        counts: Buffer,
        columns: tuple[Columns, Columns],
        lows: Buffer,
        spare: Buffer,
        histograms: tuple[Buffer, ...],
    ) -> tuple[list[Step], Columns]:
        """Return the dispatches that sort splats by the depths' low parts, then by depth keys."""
        keys, by_low = columns[0].keys, [columns[0]._replace(keys=spare), columns[1]]
        # Step 1: sort by the remainders, which drops absent splats.
        first, side = self._by_key(capacity, counts, by_low, histograms, first_keys=lows)
        sorted_lows = by_low[side]
        # Step 2: fetch the depth key of each splat in that order.
        gather = self._gather().step(counts, keys, sorted_lows.values, sorted_lows.keys)
        if side:
            by_low.reverse()
        # Step 3: sort by the keys; this sort is stable, so that equal keys keep the order of remainders.
        then, side = self._sort.steps(
            counts,
            histograms,
            by_low,
            bits=KEY_BITS,
            source=Counts.VISIBLE,
            groups=Counts.SORT_VISIBLE_GROUPS,
        )
        return [*first, gather, *then], by_low[side]
