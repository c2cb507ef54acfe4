"""The order of depth: drawn splats, nearest first, to the last bit of two floats."""

__all__ = ["DepthOrder"]

from functools import cache
from typing import Any, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import Step
from gsgen.runtime.kernels.sort.gather_keys import GatherKeys
from gsgen.runtime.kernels.sort.order_ties import OrderTies
from gsgen.runtime.kernels.sort.sort import KEY_BITS, Columns, RadixSort, SortConfig


@final
class DepthOrder:
    """What sorts splats by depth.

    Their keys are sorted, and then those that are the same are put in order by the rest of their
    depths: a few, for of a million centres most have a key of their own. Where more are the same
    than that is good for, as in a plane that is turned a little, the frame is sorted by the rests
    first, which takes twice as long: such a sort is deep.

    Args:
        device: Where it runs.
        cut: How work is cut.
        sort: The sort.
    """

    def __init__(self, device: Device, cut: SortConfig, sort: RadixSort) -> None:
        self._sort = sort
        self._ties = cache(lambda arranged: OrderTies(device, cut.walk, arranged))
        self._gather = cache(lambda: GatherKeys(device, cut.block))

    def steps(
        self,
        capacity: int,
        counts: Any,
        columns: tuple[Columns, Columns],
        lows: Any,
        origins: Any = None,
        spare: Any = None,
    ) -> tuple[list[Step], Any]:
        """Return the steps, and the buffer of drawn splats, nearest first.

        Args:
            capacity: For how many splats there is room.
            counts: The frame's counts.
            columns: The first has the keys of all splats, ABSENT where one is not drawn; and as
                much room again. All are overwritten, except for the keys where the sort is deep.
            lows: Of all splats, bits that sort as what their keys leave of their depths; ABSENT
                likewise.
            origins: Where each splat is by the order of the sets, if rows are arranged.
            spare: Room for more keys, if the sort is deep.
        """
        histogram = self._sort.histogram(capacity)
        if spare is None:
            steps, at = self._by_key(capacity, counts, list(columns), histogram)
            sorted_ = columns[at]
        else:
            steps, sorted_ = self._deep(capacity, counts, columns, lows, spare, histogram)
        arranged = () if origins is None else (origins,)
        ties = self._ties(bool(arranged))
        keys, order = sorted_
        return [*steps, ties.step(capacity, counts, keys, lows, order, *arranged)], order

    def _by_key(
        self,
        capacity: int,
        counts: Any,
        columns: list[Columns],
        histogram: Any,
        given: Any = None,
    ) -> tuple[list[Step], int]:
        """Sort by the keys in the first of ``columns``, or by those given, which stay."""
        return self._sort.steps(
            counts,
            histogram,
            columns,
            bits=KEY_BITS,
            source=Counts.VISIBLE,
            groups=Counts.SORT_VISIBLE_GROUPS,
            compacting=capacity,
            given=given,
        )

    def _deep(
        self,
        capacity: int,
        counts: Any,
        columns: tuple[Columns, Columns],
        lows: Any,
        spare: Any,
        histogram: Any,
    ) -> tuple[list[Step], Columns]:
        """Sort by what is left of depths, and then, stably, by keys."""
        keys, rest = columns[0].keys, [columns[0]._replace(keys=spare), columns[1]]
        first, at = self._by_key(capacity, counts, rest, histogram, given=lows)
        place = rest[at]
        gather = self._gather().step(counts, keys, place.values, place.keys)
        if at:
            rest.reverse()
        then, at = self._sort.steps(
            counts,
            histogram,
            rest,
            bits=KEY_BITS,
            source=Counts.VISIBLE,
            groups=Counts.SORT_VISIBLE_GROUPS,
        )
        return [*first, gather, *then], rest[at]
