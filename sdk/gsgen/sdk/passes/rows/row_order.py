"""Which rows a mask keeps, in order, without a shape that hangs on data."""

__all__ = ["Order", "order_of"]

from dataclasses import dataclass

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.detached_graph import Detached

_INT, _BOOL = ir.DataType.INT32, ir.DataType.BOOL


@dataclass(frozen=True, slots=True)
class Order:
    """The rows that a mask keeps.

    Attributes:
        count: How many, int32 [1].
        rows: The kept rows' numbers in front, in order, and zeros behind; int32 [N].
        live: Which of these are kept rows, bool [N].
    """

    count: ir.Value
    rows: ir.Value
    live: ir.Value


def order_of(draft: Detached, mask: ir.Value, size: int) -> Order:
    """Draft the order of a mask of ``size`` elements.

    ``c`` being the mask's prefix sum, the j-th kept row is the first i with c[i] > j, which is how
    many elements of ``c`` are at most j: a binary search, all rows at once, one Gather a bit.
    Unlike sorting or scattering this runs captured in every WebGPU runtime.
    """
    ones = draft.op("Cast", mask, dtype=_INT, shape=[size], to=_INT.value)
    axis = draft.constant(0, np.int64)
    sums = draft.op("CumSum", ones, axis, dtype=_INT, shape=[size])
    last = draft.constant([size - 1], np.int32)
    count = draft.op("Gather", sums, last, dtype=_INT, shape=[1], axis=0)
    number = draft.constant(np.arange(size), np.int32)
    live = draft.op("Less", number, count, dtype=_BOOL, shape=[size])
    bits = size.bit_length()
    behind = (1 << bits) - size
    filler = draft.constant(np.full(behind, np.iinfo(np.int32).max), np.int32)
    padded = draft.op("Concat", sums, filler, dtype=_INT, shape=[size + behind], axis=0)
    zero = draft.constant(0, np.int32)
    found = draft.constant(np.zeros(size), np.int32)
    for bit in reversed(range(bits)):
        step = 1 << bit
        probe = found
        if step > 1:
            ahead = draft.constant(step - 1, np.int32)
            probe = draft.op("Add", found, ahead, dtype=_INT, shape=[size])
        seen = draft.op("Gather", padded, probe, dtype=_INT, shape=[size], axis=0)
        below = draft.op("LessOrEqual", seen, number, dtype=_BOOL, shape=[size])
        by = draft.op(
            "Where", below, draft.constant(step, np.int32), zero, dtype=_INT, shape=[size]
        )
        found = draft.op("Add", found, by, dtype=_INT, shape=[size])
    rows = draft.op("Where", live, found, zero, dtype=_INT, shape=[size])
    return Order(count, rows, live)
