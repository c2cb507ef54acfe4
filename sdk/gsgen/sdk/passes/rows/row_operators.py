"""Row-wise operators, which can process all N rows instead of the K rows a mask selects.

Each function returns the rows that a node computes, or None if it may mix rows.
"""

__all__ = ["axes_of", "propagate_rows", "split_rows"]

from collections.abc import Callable, Sequence
from math import prod

import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.onnx_facts import FLOAT_TYPES
from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import (
    UNBOUNDED_END,
    constant_of,
    fixed_shape,
    int_attribute,
    rank_of,
)
from gsgen.sdk.passes.rows.row_draft import RowDraft
from gsgen.sdk.passes.rows.row_facts import Index, Linear, PaddingRowsFact, Rows, RowTensorFact

_ELEMENTWISE_OPERATORS = frozenset({
    "Abs", "Acos", "Acosh", "Add", "And", "Asin", "Asinh", "Atan", "Atanh", "Cast", "Ceil",
    "Clip", "Cos", "Cosh", "Div", "Elu", "Equal", "Erf", "Exp", "Floor", "Gelu", "Greater",
    "GreaterOrEqual", "HardSigmoid", "HardSwish", "Identity", "IsInf", "IsNaN", "LeakyRelu",
    "Less", "LessOrEqual", "Log", "Max", "Mean", "Min", "Mish", "Mod", "Mul", "Neg", "Not",
    "Or", "Pow", "Reciprocal", "Relu", "Round", "Selu", "Sigmoid", "Sign", "Sin", "Sinh",
    "Softplus", "Softsign", "Sqrt", "Sub", "Sum", "Tan", "Tanh", "Where", "Xor",
})  # fmt: skip
_AXIS_OPERATORS = frozenset({"ArgMax", "ArgMin", "CumSum", "Hardmax", "LogSoftmax", "Softmax"})

RowFacts = Sequence[RowTensorFact | None]


def propagate_rows(node: ir.Node, facts: RowFacts, draft: RowDraft) -> Rows | None:
    """Return the node's output computed on all N rows; None if the node may mix the rows."""
    if any(isinstance(fact, Rows) and fact.flat for fact in facts):
        return None
    if node.op_type in _ELEMENTWISE_OPERATORS:
        return _mask_elementwise(node, facts, draft)
    if is_op(node, "Concat"):
        return _mask_concat(node, facts, draft)
    if is_op(node, "MatMul", "Gemm"):
        return _matrix_product(node, facts, draft)
    if is_op(node, "Einsum"):
        return _mask_einsum(node, facts, draft)
    rows = facts[0]
    if not isinstance(rows, Rows) or any(isinstance(fact, Rows) for fact in facts[1:]):
        return None
    row_rule = _SINGLE_INPUT_RULES.get(node.op_type)
    return None if row_rule is None else row_rule(node, rows, facts, draft)


def _copy_for_all_rows(
    node: ir.Node, inputs: Sequence[ir.Value | None], axis: int, rows: Rows, draft: RowDraft
) -> Rows | None:
    """Create a copy of a node that computes all N rows instead of the K rows a mask selects."""
    shape = _full_shape(node.outputs[0], axis, rows)
    if shape is None or len(node.outputs) != 1:
        return None
    (result,) = draft.like(node, inputs)
    result.shape = ir.Shape(shape)
    return Rows(rows.mask, result, axis)


def _full_shape(value: ir.Value, axis: int, rows: Rows) -> list[int] | None:
    dims = list(value.shape) if value.shape is not None else None
    if dims is None or not 0 <= axis < len(dims):
        return None
    dims[axis] = rows.mask.size
    if all(isinstance(d, int) for d in dims):
        return [dim for dim in dims if isinstance(dim, int)]
    return None


def _inputs_with_all_rows(node: ir.Node, facts: RowFacts) -> list[ir.Value | None]:
    return [
        fact.value if isinstance(fact, Rows) else value
        for value, fact in zip(node.inputs, facts, strict=True)
    ]


def _mask_elementwise(node: ir.Node, facts: RowFacts, draft: RowDraft) -> Rows | None:
    """Create an elementwise operator on all N rows instead of the K rows that a mask selects."""
    row_facts = [fact for fact in facts if isinstance(fact, Rows)]
    negative_axes = {fact.axis - (rank_of(fact.value) or 0) for fact in row_facts}
    rank = rank_of(node.outputs[0])
    if (
        len(negative_axes) != 1
        or rank is None
        or any(isinstance(f, Index | PaddingRowsFact) for f in facts)
    ):
        return None
    (negative_axis,) = negative_axes
    inputs = _inputs_with_all_rows(node, facts)
    for input_index, (value, fact) in enumerate(zip(node.inputs, facts, strict=True)):
        if isinstance(fact, Linear) and value is not None:
            inputs[input_index] = value = draft.number(fact, value)
        if value is None or isinstance(fact, Rows):
            continue
        if value.shape is None:
            return None
        if len(value.shape) >= -negative_axis and value.shape[negative_axis] != 1:
            return None
    is_integer_division = is_op(node, "Div", "Mod") and node.outputs[0].dtype not in FLOAT_TYPES
    if is_integer_division:  # a masked row might divide an integer by zero, which stops the runtime
        known = constant_of(node.inputs[1])
        if known is None or not known.all():
            return None
    return _copy_for_all_rows(node, inputs, rank + negative_axis, row_facts[0], draft)


def _mask_concat(node: ir.Node, facts: RowFacts, draft: RowDraft) -> Rows | None:
    rows = facts[0]
    if not isinstance(rows, Rows) or not all(isinstance(fact, Rows) for fact in facts):
        return None
    axis = node.attributes["axis"].as_int() % (rank_of(rows.value) or 1)
    is_compatible = all(isinstance(fact, Rows) and fact.axis == rows.axis for fact in facts)
    if axis == rows.axis or not is_compatible:
        return None
    return _copy_for_all_rows(node, _inputs_with_all_rows(node, facts), rows.axis, rows, draft)


def _matrix_product(node: ir.Node, facts: RowFacts, draft: RowDraft) -> Rows | None:
    """Create a MatMul or Gemm on all N rows instead of the K rows that a mask selects."""
    row_facts = [fact for fact in facts if isinstance(fact, Rows)]
    if len(row_facts) != sum(fact is not None for fact in facts) or not row_facts:
        return None
    row_axis = _gemm_row_axis(node, facts) if is_op(node, "Gemm") else _matmul_row_axis(node, facts)
    if row_axis is None:
        return None
    return _copy_for_all_rows(
        node, _inputs_with_all_rows(node, facts), row_axis, row_facts[0], draft
    )


def _gemm_row_axis(node: ir.Node, facts: RowFacts) -> int | None:
    rows = facts[0]
    bias = node.inputs[2] if len(node.inputs) > 2 else None
    is_compatible = bias is None or rank_of(bias) in (0, 1) or (bias.shape or [0])[0] == 1
    if not isinstance(rows, Rows) or any(facts[1:]) or rows.axis != 0 or not is_compatible:
        return None
    return None if int_attribute(node, "transA", 0) else 0


def _matmul_row_axis(node: ir.Node, facts: RowFacts) -> int | None:
    """Return the axis of the rows in a matrix product; batched operands must share the axis."""
    values = _inputs_with_all_rows(node, facts)
    ranks, result_rank = [rank_of(value) for value in values], rank_of(node.outputs[0])
    if None in ranks or result_rank is None or 1 in ranks:
        rows = facts[0]
        is_matrix_vector = isinstance(rows, Rows) and facts[1] is None and ranks[1] == 1
        if is_matrix_vector and isinstance(rows, Rows) and rows.axis + 1 < (ranks[0] or 0):
            return rows.axis
        return None
    negative_axes = {
        fact.axis - (rank or 0)
        for fact, rank in zip(facts, ranks, strict=True)
        if isinstance(fact, Rows)
    }
    if len(negative_axes) != 1:
        return None
    (axis,) = negative_axes
    if axis > -3:  # Case 2: rows of the left matrix, or columns of the right one
        operand_index = 0 if axis == -2 else 1
        is_single_row_operand = (
            isinstance(facts[operand_index], Rows) and facts[1 - operand_index] is None
        )
        return result_rank + axis if is_single_row_operand else None
    for value, fact in zip(values, facts, strict=True):
        shape = value.shape if value is not None else None
        if fact is None and (shape is None or (len(shape) >= -axis and shape[axis] != 1)):
            return None
    return result_rank + axis


def _mask_einsum(node: ir.Node, facts: RowFacts, draft: RowDraft) -> Rows | None:
    """Create an Einsum on all N rows instead of the K rows that a mask selects."""
    row_facts = [fact for fact in facts if isinstance(fact, Rows)]
    input_terms, arrow_token, output_term = (
        node.attributes["equation"].as_string().replace(" ", "").partition("->")
    )
    terms = input_terms.split(",")
    if (
        not arrow_token
        or "." in input_terms + output_term
        or len(terms) != len(facts)
        or not row_facts
    ):
        return None
    einsum_letters = {
        term[fact.axis] for term, fact in zip(terms, facts, strict=True) if isinstance(fact, Rows)
    }
    other_letters = "".join(
        t for t, fact in zip(terms, facts, strict=True) if not isinstance(fact, Rows)
    )
    if len(einsum_letters) != 1 or any(
        fact is not None and fact not in row_facts for fact in facts
    ):
        return None
    (letter,) = einsum_letters
    is_letter_used_once = (
        all(term.count(letter) <= 1 for term in terms) and output_term.count(letter) == 1
    )
    if not is_letter_used_once or letter in other_letters:
        return None
    return _copy_for_all_rows(
        node, _inputs_with_all_rows(node, facts), output_term.index(letter), row_facts[0], draft
    )


# -- Operators with one tensor of rows


def _mask_slice(node: ir.Node, rows: Rows, facts: RowFacts, draft: RowDraft) -> Rows | None:
    """Create a Slice of all N rows, not the K that a mask selects; None if it cuts the row axis."""
    arrays = [constant_of(value) for value in node.inputs[1:]]
    if any(array is None for array in arrays) or len(arrays) < 2:
        return None
    starts, ends, *axes_and_steps = [array.reshape(-1) for array in arrays if array is not None]
    rank = rank_of(rows.value) or 1
    axes = axes_and_steps[0] % rank if axes_and_steps else np.arange(len(starts))
    steps = axes_and_steps[1] if len(axes_and_steps) > 1 else np.ones(len(starts), np.int64)
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        if axis == rows.axis and not (start == 0 and end >= UNBOUNDED_END and step == 1):
            return None
    return _copy_for_all_rows(node, [rows.value, *node.inputs[1:]], rows.axis, rows, draft)


def _mask_gather(node: ir.Node, rows: Rows, facts: RowFacts, draft: RowDraft) -> Rows | None:
    """Create a Gather on all N rows, not the K that a mask selects; None if it gathers rows."""
    rank = rank_of(rows.value) or 1
    axis, index = int_attribute(node, "axis", 0) % rank, rank_of(node.inputs[1])
    if axis == rows.axis or index is None or facts[1] is not None:
        return None
    row_axis = rows.axis + (index - 1 if axis < rows.axis else 0)
    return _copy_for_all_rows(node, [rows.value, *node.inputs[1:]], row_axis, rows, draft)


def axes_of(node: ir.Node) -> list[int] | None:
    """Return the axes of a node, from its attribute or its second input; None if unknown."""
    if "axes" in node.attributes:
        return [int(axis) for axis in node.attributes["axes"].as_ints()]
    known = constant_of(node.inputs[1]) if len(node.inputs) > 1 else None
    return None if known is None else [int(axis) for axis in known.reshape(-1)]


def _mask_reduce(node: ir.Node, rows: Rows, facts: RowFacts, draft: RowDraft) -> Rows | None:
    axes, rank = axes_of(node), rank_of(rows.value) or 1
    if not axes:
        return None
    reduced_axes = {axis % rank for axis in axes}
    if rows.axis in reduced_axes:
        return None
    removed_axes = (
        0 if int_attribute(node, "keepdims", 1) else sum(p < rows.axis for p in reduced_axes)
    )
    return _copy_for_all_rows(
        node, [rows.value, *node.inputs[1:]], rows.axis - removed_axes, rows, draft
    )


def _mask_along_axis(node: ir.Node, rows: Rows, facts: RowFacts, draft: RowDraft) -> Rows | None:
    rank = rank_of(rows.value) or 1
    if is_op(node, "CumSum"):
        known = constant_of(node.inputs[1])
        axis = None if known is None else int(known.reshape(-1)[0]) % rank
    else:
        axis = int_attribute(node, "axis", 0 if is_op(node, "ArgMax", "ArgMin") else -1) % rank
    if axis is None or axis == rows.axis:
        return None
    does_drop_axis = is_op(node, "ArgMax", "ArgMin") and not int_attribute(node, "keepdims", 1)
    row_axis = rows.axis - (1 if does_drop_axis and axis < rows.axis else 0)
    return _copy_for_all_rows(node, [rows.value, *node.inputs[1:]], row_axis, rows, draft)


def _mask_squeeze(node: ir.Node, rows: Rows, facts: RowFacts, draft: RowDraft) -> Rows | None:
    axes, rank = axes_of(node), rank_of(rows.value) or 1
    if axes is None or rows.axis in {axis % rank for axis in axes}:
        return None
    row_axis = rows.axis - sum(axis % rank < rows.axis for axis in axes)
    return _copy_for_all_rows(node, [rows.value, *node.inputs[1:]], row_axis, rows, draft)


def _mask_unsqueeze(node: ir.Node, rows: Rows, facts: RowFacts, draft: RowDraft) -> Rows | None:
    axes, rank = axes_of(node), rank_of(node.outputs[0])
    if axes is None or rank is None:
        return None
    bias = {axis % rank for axis in axes}
    row_axis = [axis for axis in range(rank) if axis not in bias][rows.axis]
    return _copy_for_all_rows(node, [rows.value, *node.inputs[1:]], row_axis, rows, draft)


def _mask_transpose(node: ir.Node, rows: Rows, facts: RowFacts, draft: RowDraft) -> Rows | None:
    rank = rank_of(rows.value) or 1
    order = node.attributes.get("perm")
    axes = list(range(rank))[::-1] if order is None else list(order.as_ints())
    return _copy_for_all_rows(node, [rows.value], axes.index(rows.axis), rows, draft)


def _mask_reshape(node: ir.Node, rows: Rows, facts: RowFacts, draft: RowDraft) -> Rows | None:
    """Create a Reshape of all N rows, not the K that a mask selects; None if it divides rows."""
    shape, rank = fixed_shape(rows.value), rank_of(node.outputs[0])
    if shape is None or rank is None or rows.axis != 0:
        return None
    target = _target_shape(node, facts)
    if target is None:
        return None
    if target == [-1] and len(shape) > 1:
        return Rows(rows.mask, rows.value, 0, flat=True)
    if not target or target[0] != -1:
        return None
    row_shape = [
        shape[axis] if size == 0 and not int_attribute(node, "allowzero", 0) else size
        for axis, size in enumerate(target)
    ][1:]
    if prod(row_shape) != prod(shape[1:]) or min(row_shape, default=1) < 0:
        return None
    return Rows(rows.mask, draft.reshaped(rows.value, [rows.mask.size, *row_shape]), 0)


def _target_shape(node: ir.Node, facts: RowFacts) -> list[int] | None:
    """Return the target shape of a Reshape, with −1 for the axis of the rows; None if unknown."""
    target = facts[1] if len(facts) > 1 else None
    if isinstance(target, Linear):
        is_leading_dim_one = target.factor[:1].tolist() == [1] and target.constant[0] == 0
        if not is_leading_dim_one or target.factor[1:].any():
            return None
        return [-1, *(int(size) for size in target.constant[1:])]
    known = constant_of(node.inputs[1])
    if known is None:
        return None
    sizes = [int(size) for size in known]
    if sizes[:1] == [0] and not int_attribute(node, "allowzero", 0):
        if -1 in sizes:
            shape = fixed_shape(facts[0].value) if isinstance(facts[0], Rows) else None
            known_size = prod(size for size in sizes[1:] if size > 0)
            if shape is None or 0 in sizes[1:] or not known_size:
                return None
            sizes[sizes.index(-1)] = prod(shape[1:]) // known_size
        sizes[0] = -1
    return sizes


def _mask_expand(node: ir.Node, rows: Rows, facts: RowFacts, draft: RowDraft) -> Rows | None:
    """Create an Expand of all N rows, not the K that a mask selects; None if it repeats rows."""
    target, shape = facts[1], fixed_shape(rows.value)
    if not isinstance(target, Linear) or shape is None or target.factor.sum() != 1:
        known = constant_of(node.inputs[1])
        if known is None or shape is None or len(known) > len(shape):
            return None
        sizes = [int(size) for size in known]
        target_axis = rows.axis - (len(shape) - len(sizes))
        if target_axis >= 0 and sizes[target_axis] != 1:
            return None
    else:
        sizes = [int(size) for size in target.constant]
        target_axis = int(np.argmax(target.factor))
        if (
            sizes[target_axis]
            or target_axis - len(sizes) != rows.axis - len(shape)
            or (target.factor < 0).any()
        ):
            return None
        sizes[target_axis] = rows.mask.size
    expanded_shape = [int(size) for size in np.broadcast_shapes(shape, tuple(sizes))]
    axis = rows.axis + len(expanded_shape) - len(shape)
    expanded_value = draft.op(
        "Expand", rows.value, draft.constant(expanded_shape, np.int64), shape=expanded_shape
    )
    return Rows(rows.mask, expanded_value, axis)


_RowRule = Callable[[ir.Node, Rows, RowFacts, RowDraft], Rows | None]
_SINGLE_INPUT_RULES: dict[str, _RowRule] = {
    "Expand": _mask_expand,
    "Gather": _mask_gather,
    "Reshape": _mask_reshape,
    "Slice": _mask_slice,
    "Squeeze": _mask_squeeze,
    "Transpose": _mask_transpose,
    "Unsqueeze": _mask_unsqueeze,
    **dict.fromkeys(_AXIS_OPERATORS, _mask_along_axis),
    **dict.fromkeys(
        (
            *("ReduceL1", "ReduceL2", "ReduceLogSum", "ReduceLogSumExp", "ReduceMax"),
            *("ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum", "ReduceSumSquare"),
        ),
        _mask_reduce,
    ),
}


def split_rows(node: ir.Node, facts: RowFacts, draft: RowDraft) -> list[Rows] | None:
    """Return the outputs of a Split along an axis other than the row axis, with all N rows."""
    rows = facts[0]
    if not isinstance(rows, Rows) or rows.flat or any(facts[1:]):
        return None
    shapes = [_full_shape(value, rows.axis, rows) for value in node.outputs]
    axis = int_attribute(node, "axis", 0) % (rank_of(rows.value) or 1)
    if axis == rows.axis or any(shape is None for shape in shapes):
        return None
    parts = draft.like(node, [rows.value, *node.inputs[1:]])
    for value, shape in zip(parts, shapes, strict=True):
        value.shape = ir.Shape(shape or ())
    return [Rows(rows.mask, value, rows.axis) for value in parts]
