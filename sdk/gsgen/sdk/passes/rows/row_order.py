"""The order that puts the rows a mask selects first, computed with static shapes."""

__all__ = ["RowOrder", "draft_order"]

from dataclasses import dataclass

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.detached_graph import DetachedGraph

_INT32, _BOOL = ir.DataType.INT32, ir.DataType.BOOL


@dataclass(frozen=True, slots=True)
class RowOrder:
    """The graph values that sort rows by a boolean mask: selected rows first."""

    count: ir.Value  # number of kept rows, int32 [1]
    rows: ir.Value  # indices of the kept rows in ascending order, then zeros; int32 [N]
    live: ir.Value  # true for the first ``count`` elements, bool [N]


def draft_order(draft: DetachedGraph, mask: ir.Value, size: int) -> RowOrder:
    """Create the graph nodes that compute the order of a row mask: selected rows first.

    Let c be the mask's prefix sum. The j-th kept row is the first i with c[i] > j, so i is the
    number of elements of c that are at most j. A binary search finds it for all j at once, with
    one Gather per bit. Unlike a sort or a scatter, every WebGPU runtime captures these operators.
    """
    # Step 1: the prefix sum; its last element is the count.
    flags = draft.op("Cast", mask, dtype=_INT32, shape=[size], to=_INT32.value)
    axis = draft.constant(0, np.int64)
    cumulative_sums = draft.op("CumSum", flags, axis, dtype=_INT32, shape=[size])
    last_index = draft.constant([size - 1], np.int32)
    count = draft.op("Gather", cumulative_sums, last_index, dtype=_INT32, shape=[1], axis=0)
    number = draft.constant(np.arange(size), np.int32)
    live = draft.op("Less", number, count, dtype=_BOOL, shape=[size])
    # Step 2: pad the prefix sum to a power of two; the padding compares as larger than any j.
    bits = size.bit_length()
    padding = (1 << bits) - size
    fill_value = draft.constant(np.full(padding, np.iinfo(np.int32).max), np.int32)
    padded_sums = draft.op(
        "Concat", cumulative_sums, fill_value, dtype=_INT32, shape=[size + padding], axis=0
    )
    zero = draft.constant(0, np.int32)
    kept_rows = draft.constant(np.zeros(size), np.int32)
    # Step 3: set the bits of i from the highest to the lowest.
    for bit in reversed(range(bits)):
        step = 1 << bit
        probe = kept_rows
        if step > 1:
            last_index_before_range = draft.constant(step - 1, np.int32)
            probe = draft.op("Add", kept_rows, last_index_before_range, dtype=_INT32, shape=[size])
        prefix = draft.op("Gather", padded_sums, probe, dtype=_INT32, shape=[size], axis=0)
        is_below = draft.op("LessOrEqual", prefix, number, dtype=_BOOL, shape=[size])
        step_increment = draft.op(
            "Where", is_below, draft.constant(step, np.int32), zero, dtype=_INT32, shape=[size]
        )
        kept_rows = draft.op("Add", kept_rows, step_increment, dtype=_INT32, shape=[size])
    rows = draft.op("Where", live, kept_rows, zero, dtype=_INT32, shape=[size])
    return RowOrder(count, rows, live)
