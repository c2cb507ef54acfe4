"""Where the number of rows is fixed again: what goes back, is filled up, or is summed.

Each function returns the drafted value, or None where it does not understand the node.
"""

__all__ = ["padded", "reduced", "scattered"]

from collections.abc import Sequence
from math import prod

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import (
    constant_of,
    fixed_shape,
    int_attribute,
    rank_of,
)
from gsgen.sdk.passes.rows.row_draft import RowDraft
from gsgen.sdk.passes.rows.row_facts import Fact, Filler, Index, Linear, Rows
from gsgen.sdk.passes.rows.row_operators import axes_of

_FLOATS = (ir.DataType.FLOAT, ir.DataType.FLOAT16, ir.DataType.DOUBLE)
# What takes no part in a reduction.
_NEUTRAL = {"ReduceSum": 0.0, "ReduceMean": 0.0, "ReduceMax": -np.inf, "ReduceMin": np.inf}

Facts = Sequence[Fact | None]


def scattered(node: ir.Node, facts: Facts, draft: RowDraft) -> ir.Value | None:
    """Draft what ScatterND gives when rows of a mask go back to where they came from."""
    data, shape = node.inputs[0], fixed_shape(node.inputs[0])
    _, index, rows = facts
    plain = node.attributes.get("reduction")
    if data is None or shape is None or facts[0] is not None:
        return None
    if not isinstance(index, Index) or not isinstance(rows, Rows) or rows.axis != 0:
        return None
    mask = index.mask
    if mask.within is not None:  # its places are counted among kept rows
        return None
    dims = (*mask.dims, *mask.behind)
    if index.form != "rows" or (plain is not None and plain.as_string() != "none"):
        return None
    rest = [*mask.behind] if mask.behind else list(shape[len(dims) :])
    updates = fixed_shape(rows.value)
    if shape[: len(dims)] != dims or rows.flat != bool(mask.behind) or updates is None:
        return None
    if list(updates) != [mask.size, *rest]:
        return None
    all_rows = draft.reshaped(rows.value, shape)
    kept = draft.truth(mask)
    kept = draft.reshaped(kept, [*mask.dims, *[1] * (len(shape) - len(mask.dims))])
    return draft.op("Where", kept, all_rows, data, dtype=data.dtype, shape=shape)


def reduced(node: ir.Node, facts: Facts, draft: RowDraft) -> ir.Value | None:
    """Draft a sum, mean or extreme over the kept rows: the others take part as nothing does.

    Of no rows at all the sum and (in ONNX Runtime) the mean is zero, and the largest is −∞.
    """
    if not is_op(node, *_NEUTRAL):
        return None
    rows, axes = facts[0], axes_of(node)
    shape = fixed_shape(rows.value) if isinstance(rows, Rows) else None
    kind = node.outputs[0].dtype
    if not isinstance(rows, Rows) or shape is None or rows.flat or not axes or kind is None:
        return None
    exact = is_op(node, "ReduceSum") or kind in _FLOATS
    places = {axis % len(shape) for axis in axes}
    if not exact or rows.axis not in places:
        return None
    dims = [1] * len(shape)
    dims[rows.axis] = rows.mask.size
    kept = draft.reshaped(draft.truth(rows.mask), dims)
    filler = draft.constant(_NEUTRAL[node.op_type], kind.numpy())
    whole = draft.op("Where", kept, rows.value, filler, dtype=kind, shape=shape)
    if not is_op(node, "ReduceMean"):
        return draft.like(node, [whole, *node.inputs[1:]])[0]
    along = draft.constant(sorted(places), np.int64)
    total = draft.op("ReduceSum", whole, along, keepdims=int_attribute(node, "keepdims", 1))
    one = draft.constant(1, np.int32)
    count = draft.op("Max", draft.order(rows.mask).count, one, shape=[1])
    number = draft.op("Cast", count, dtype=kind, shape=[1], to=kind.value)
    others = prod(shape[place] for place in places if place != rows.axis)
    number = draft.op("Mul", number, draft.constant(others, kind.numpy()), shape=[1])
    return draft.op("Div", total, draft.reshaped(number, []))


def padded(node: ir.Node, facts: Facts, draft: RowDraft) -> ir.Value | None:
    """Draft what Concat or Pad gives when rows are filled up to a capacity."""
    rows = facts[0]
    if not isinstance(rows, Rows) or rows.axis != 0 or rows.flat:
        return None
    found = _concatenated(node, facts) if is_op(node, "Concat") else _pads(node, facts)
    shape = fixed_shape(rows.value)
    if found is None or shape is None:
        return None
    capacity, row = found
    missing = capacity - rows.mask.size
    if missing < 0:  # more rows may be kept than there is room for: then the model fails
        return None
    made = draft.compact(rows, row)
    if not missing:
        return made
    behind = np.broadcast_to(row, (missing, *shape[1:]))
    more = draft.constant(behind, row.dtype)
    return draft.op("Concat", made, more, shape=[capacity, *shape[1:]], axis=0)


def _concatenated(node: ir.Node, facts: Facts) -> tuple[int, np.ndarray] | None:
    if len(facts) != 2 or not isinstance(facts[1], Filler):
        return None
    rank = rank_of(node.outputs[0])
    if rank is None or node.attributes["axis"].as_int() % rank != 0:
        return None
    return facts[1].capacity, facts[1].row


def _pads(node: ir.Node, facts: Facts) -> tuple[int, np.ndarray] | None:
    mode, amounts = node.attributes.get("mode"), facts[1] if len(facts) > 1 else None
    rank = rank_of(node.inputs[0]) or 0
    if (mode is not None and mode.as_string() != "constant") or len(facts) > 3:
        return None
    if not isinstance(amounts, Linear) or amounts.factor.shape != (2 * rank,):
        return None
    factor, constant = amounts.factor.copy(), amounts.constant.copy()
    if factor[rank] != -1:
        return None
    capacity, factor[rank], constant[rank] = int(constant[rank]), 0, 0
    given = node.inputs[2] if len(node.inputs) > 2 else None
    known = constant_of(given)
    kind = node.outputs[0].dtype
    if (
        factor.any()
        or constant.any()
        or (given is not None and known is None)
        or kind is None
    ):
        return None
    return capacity, np.asarray(0 if known is None else known.reshape(()), kind.numpy())
