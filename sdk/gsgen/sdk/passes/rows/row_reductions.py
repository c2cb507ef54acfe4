"""Operators whose output size no longer depends on a row mask: scatter, padding, reduction.

Each function returns the drafted value, or None if it does not support the node.
"""

__all__ = ["pad_rows", "reduce_rows", "rows_of_fixed_count", "scatter_rows"]

from collections.abc import Sequence
from math import prod

import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.onnx_facts import FLOAT_TYPES
from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import (
    constant_of,
    fixed_shape,
    int_attribute,
    rank_of,
    required,
)
from gsgen.sdk.passes.rows.row_draft import RowDraft
from gsgen.sdk.passes.rows.row_facts import (
    Index,
    Linear,
    Mask,
    PaddingRowsFact,
    Rows,
    RowTensorFact,
)
from gsgen.sdk.passes.rows.row_operators import axes_of

# The neutral element of each reduction.
_NEUTRAL_BY_OPERATOR = {
    "ReduceSum": 0.0,
    "ReduceMean": 0.0,
    "ReduceMax": -np.inf,
    "ReduceMin": np.inf,
}

RowFacts = Sequence[RowTensorFact | None]


def scatter_rows(node: ir.Node, facts: RowFacts, draft: RowDraft) -> ir.Value | None:
    """Create the output of a ScatterND that writes selected rows back to their positions."""
    data, shape = node.inputs[0], fixed_shape(node.inputs[0])
    _, index, rows = facts
    reduction = node.attributes.get("reduction")
    if data is None or shape is None or facts[0] is not None:
        return None
    if not isinstance(index, Index) or not isinstance(rows, Rows) or rows.axis != 0:
        return None
    mask = index.mask
    if mask.parent is not None:  # its indices count the rows of the parent mask
        return None
    dims = (*mask.dims, *mask.repeats)
    if index.index_form != "rows" or (reduction is not None and reduction.as_string() != "none"):
        return None
    row_shape = [*mask.repeats] if mask.repeats else list(shape[len(dims) :])
    updates = fixed_shape(rows.value)
    if shape[: len(dims)] != dims or rows.flat != bool(mask.repeats) or updates is None:
        return None
    if list(updates) != [mask.size, *row_shape]:
        return None
    all_rows_output = draft.reshaped(rows.value, shape)
    row_mask = draft.boolean_mask(mask)
    row_mask = draft.reshaped(row_mask, [*mask.dims, *[1] * (len(shape) - len(mask.dims))])
    return draft.op("Where", row_mask, all_rows_output, data, dtype=data.dtype, shape=shape)


def reduce_rows(node: ir.Node, facts: RowFacts, draft: RowDraft) -> ir.Value | None:
    """Create a reduction over selected rows; other rows contribute the neutral element.

    Without any row the sum and (in ONNX Runtime) the mean are zero, and the maximum is −∞.
    """
    if not is_op(node, *_NEUTRAL_BY_OPERATOR):
        return None
    rows, axes = facts[0], axes_of(node)
    shape = fixed_shape(rows.value) if isinstance(rows, Rows) else None
    kind = node.outputs[0].dtype
    if not isinstance(rows, Rows) or shape is None or rows.flat or not axes or kind is None:
        return None
    is_exact_sum = is_op(node, "ReduceSum") or kind in FLOAT_TYPES
    reduced_axes = {axis % len(shape) for axis in axes}
    if not is_exact_sum or rows.axis not in reduced_axes:
        return None
    dims = [1] * len(shape)
    dims[rows.axis] = rows.mask.size
    row_mask = draft.reshaped(draft.boolean_mask(rows.mask), dims)
    fill_value = draft.constant(_NEUTRAL_BY_OPERATOR[node.op_type], kind.numpy())
    masked_values = draft.op("Where", row_mask, rows.value, fill_value, dtype=kind, shape=shape)
    if not is_op(node, "ReduceMean"):
        return draft.like(node, [masked_values, *node.inputs[1:]])[0]
    reduction_axes = draft.constant(sorted(reduced_axes), np.int64)
    total = draft.op(
        "ReduceSum", masked_values, reduction_axes, keepdims=int_attribute(node, "keepdims", 1)
    )
    minimum = draft.constant(1, np.int32)
    count = draft.op("Max", draft.order(rows.mask).count, minimum, shape=[1])
    number = draft.op("Cast", count, dtype=kind, shape=[1], to=kind.value)
    elements_per_row = prod(shape[axis] for axis in reduced_axes if axis != rows.axis)
    number = draft.op("Mul", number, draft.constant(elements_per_row, kind.numpy()), shape=[1])
    return draft.op("Div", total, draft.reshaped(number, []))


def rows_of_fixed_count(node: ir.Node, facts: RowFacts, draft: RowDraft) -> ir.Value | None:
    """Create the output of a Reshape to a fixed shape, which says how many rows a mask selects."""
    rows, target = facts[0], constant_of(node.inputs[1])
    shape = fixed_shape(rows.value) if isinstance(rows, Rows) else None
    if not isinstance(rows, Rows) or rows.axis or rows.flat or shape is None or target is None:
        return None
    sizes = [int(size) for size in target]
    row_size = prod(shape[1:])
    if min(sizes, default=0) <= 0 or not row_size or prod(sizes) % row_size:
        return None
    count = prod(sizes) // row_size
    if count > rows.mask.size:
        return None
    draft.fixed_counts[rows.mask.without_repeats] = count
    dims, kind = rows.mask.dims, rows.value.dtype
    if len(dims) == 2 and count == dims[0] and _has_at_most_one_true_in_a_row(rows.mask):
        # Case 1: one of each row of the mask. The others contribute zero to a sum.
        mask = draft.reshaped(draft.boolean_mask(rows.mask), [*dims, *[1] * (len(shape) - 1)])
        values = draft.reshaped(rows.value, [*dims, *shape[1:]])
        zero = draft.constant(0, required(kind).numpy())
        masked = draft.op("Where", mask, values, zero, dtype=kind, shape=[*dims, *shape[1:]])
        axes = draft.constant([1], np.int64)
        selected = draft.op("ReduceSum", masked, axes, shape=[count, *shape[1:]], keepdims=0)
    else:
        # Case 2: the first rows after the selected ones have been moved forward.
        ends = (draft.constant([number], np.int64) for number in (0, count, 0))
        selected = draft.op("Slice", draft.compact(rows), *ends, shape=[count, *shape[1:]])
    return draft.reshaped(selected, sizes)


def _has_at_most_one_true_in_a_row(mask: Mask) -> bool:
    """Return whether a mask compares each row's number with different constants, as ``one_hot``."""
    node = mask.root.producer()
    while node is not None and is_op(node, "Cast", "Greater"):
        threshold = constant_of(node.inputs[1]) if is_op(node, "Greater") else np.zeros(1)
        if threshold is None or threshold.size != 1 or not 0 <= threshold.reshape(()) < 1:
            return False
        node = node.inputs[0].producer() if node.inputs[0] is not None else None
    if node is None or not is_op(node, "Equal"):
        return False
    for number, labels in (node.inputs, reversed(node.inputs)):
        known, shape = constant_of(labels), fixed_shape(number)
        if known is None or shape is None or shape[-1:] != (1,):
            continue
        return bool(known.size == known.shape[-1] == len(np.unique(known)))
    return False


def pad_rows(node: ir.Node, facts: RowFacts, draft: RowDraft) -> ir.Value | None:
    """Create the output of a Concat or Pad that pads selected rows to a fixed capacity."""
    rows = facts[0]
    if not isinstance(rows, Rows) or rows.axis != 0 or rows.flat:
        return None
    padding = (
        _concat_padding(node, facts) if is_op(node, "Concat") else _padding_of_pad_node(node, facts)
    )
    shape = fixed_shape(rows.value)
    if padding is None or shape is None:
        return None
    capacity, row = padding
    missing = capacity - rows.mask.size
    if missing < 0:  # the mask may keep more rows than the capacity: then the model fails
        return None
    compacted_rows = draft.compact(rows, row)
    if not missing:
        return compacted_rows
    filler_rows = np.broadcast_to(row, (missing, *shape[1:]))
    fill_value = draft.constant(filler_rows, row.dtype)
    return draft.op("Concat", compacted_rows, fill_value, shape=[capacity, *shape[1:]], axis=0)


def _concat_padding(node: ir.Node, facts: RowFacts) -> tuple[int, np.ndarray] | None:
    if len(facts) != 2 or not isinstance(facts[1], PaddingRowsFact):
        return None
    rank = rank_of(node.outputs[0])
    if rank is None or node.attributes["axis"].as_int() % rank != 0:
        return None
    return facts[1].capacity, facts[1].row


def _padding_of_pad_node(node: ir.Node, facts: RowFacts) -> tuple[int, np.ndarray] | None:
    mode, pad_sizes = node.attributes.get("mode"), facts[1] if len(facts) > 1 else None
    rank = rank_of(node.inputs[0]) or 0
    if (mode is not None and mode.as_string() != "constant") or len(facts) > 3:
        return None
    if not isinstance(pad_sizes, Linear) or pad_sizes.factor.shape != (2 * rank,):
        return None
    factor, constant = pad_sizes.factor.copy(), pad_sizes.constant.copy()
    if factor[rank] != -1:
        return None
    capacity, factor[rank], constant[rank] = int(constant[rank]), 0, 0
    fill_input = node.inputs[2] if len(node.inputs) > 2 else None
    known = constant_of(fill_input)
    kind = node.outputs[0].dtype
    if factor.any() or constant.any() or (fill_input is not None and known is None) or kind is None:
        return None
    return capacity, np.asarray(0 if known is None else known.reshape(()), kind.numpy())
