"""Evaluates ONNX operators column by column, for long and narrow tensors.

A tensor [rows, a, b, …] is a NumPy array [a, b, …] of columns: an operator on the axes after the
first becomes the same NumPy operation on that array.
"""

__all__ = [
    "ELEMENTWISE_OPERATORS",
    "Columns",
    "EmitNode",
    "columns_of",
    "reduction_axes",
    "works_on_columns",
]

from collections.abc import Callable, Sequence
from functools import reduce
from math import prod
from typing import Any

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import (
    attribute_values,
    constant_of,
    fixed_shape,
    int_attribute,
    required,
    split_sizes,
)

Columns = np.ndarray[Any, np.dtype[np.object_]]
# Writes one operator on columns and returns its result; operands are columns or numbers.
EmitNode = Callable[[str, Sequence[Any], dict[str, Any]], Any]
ColumnLookup = Callable[[ir.Value], Columns]

ELEMENTWISE_OPERATORS = frozenset({
    "Abs", "Add", "And", "Cast", "Ceil", "Clip", "Cos", "Div", "Equal", "Exp", "Floor",
    "Greater", "GreaterOrEqual", "Less", "LessOrEqual", "Log", "Max", "Min", "Mul", "Neg",
    "Not", "Or", "Reciprocal", "Relu", "Sigmoid", "Sin", "Sqrt", "Sub", "Tanh", "Where",
})  # fmt: skip
_OPERATOR_BY_REDUCTION = {
    "ReduceL2": "Add",
    "ReduceMax": "Max",
    "ReduceMin": "Min",
    "ReduceSum": "Add",
}
_RESHAPE_OPERATORS = ("Expand", "Reshape", "Squeeze", "Unsqueeze")


def works_on_columns(node: ir.Node, rows: int) -> bool:
    """Return whether a node on tensors of many rows can be evaluated column by column."""
    if is_op(node, *ELEMENTWISE_OPERATORS):
        return all(value is None or _may_be_row_operand(value, node, rows) for value in node.inputs)
    first = node.inputs[0] if node.inputs else None
    shape = fixed_shape(first)
    if not shape or shape[0] != rows:
        return False
    if is_op(node, *_OPERATOR_BY_REDUCTION):
        axes = reduction_axes(node, len(shape))
        return bool(axes) and 0 not in axes
    if is_op(node, *_RESHAPE_OPERATORS):
        return True
    if is_op(node, "Concat"):
        return int_attribute(node, "axis", 0) % len(shape) > 0
    if is_op(node, "Transpose"):
        perm = node.attributes.get("perm")
        return perm is not None and next(iter(perm.as_ints())) == 0
    if is_op(node, "Gather"):
        known = all(constant_of(value) is not None for value in node.inputs[1:])
        return int_attribute(node, "axis", 0) % len(shape) > 0 and known
    if is_op(node, "Slice"):
        return _slices_of_node(node, len(shape)) is not None
    if is_op(node, "Split"):
        return int_attribute(node, "axis", 0) % len(shape) > 0 and split_sizes(node) is not None
    return False


def columns_of(
    node: ir.Node,
    inputs: Sequence[ir.Value | None],
    rows: int,
    lookup: ColumnLookup,
    emit: EmitNode,
) -> list[Columns]:
    """Compute the columns of an ONNX node's outputs from the columns of its inputs.

    ``lookup`` returns the columns of a tensor with ``rows`` rows; ``emit`` writes an operator.
    """
    if is_op(node, *ELEMENTWISE_OPERATORS):
        return [_compute_elementwise(node, inputs, rows, lookup, emit)]
    first = required(inputs[0])
    columns, shape = lookup(first), required(fixed_shape(node.outputs[0]))
    if is_op(node, *_OPERATOR_BY_REDUCTION):
        return [_compute_reduction(node, columns, emit).reshape(shape[1:])]
    if is_op(node, "Expand"):
        return [np.broadcast_to(columns, shape[1:])]
    if is_op(node, *_RESHAPE_OPERATORS):
        return [columns.reshape(shape[1:])]
    axis = int_attribute(node, "axis", 0) % (columns.ndim + 1) - 1
    if is_op(node, "Concat"):
        return [np.concatenate([lookup(value) for value in inputs if value is not None], axis)]
    if is_op(node, "Transpose"):
        perm = node.attributes["perm"].as_ints()
        return [columns.transpose([axis_number - 1 for axis_number in list(perm)[1:]])]
    if is_op(node, "Gather"):
        indices = required(constant_of(inputs[1]))
        shape = required(fixed_shape(node.outputs[0]))
        gathered_columns = np.empty(shape[1:], object)
        gathered_columns[...] = np.take(columns, indices, axis)  # a single index returns no array
        return [gathered_columns]
    if is_op(node, "Slice"):
        slices = required(_slices_of_node(node, columns.ndim + 1))
        return [columns[slices]]
    sizes = required(split_sizes(node))
    return list(np.split(columns, np.cumsum(sizes)[:-1], axis))


def _may_be_row_operand(value: ir.Value, node: ir.Node, rows: int) -> bool:
    """Return whether a value can be an operand of a node that is computed column by column."""
    shape, result_shape = fixed_shape(value), fixed_shape(node.outputs[0])
    if shape is None or result_shape is None:
        return False
    if len(shape) == len(result_shape) and shape and shape[0] == rows:
        return True
    if prod(shape) == 1:
        return True
    # Case 3: constant numbers, one for each column.
    flat = len(shape) < len(result_shape) or shape[0] == 1
    return flat and constant_of(value) is not None


def _compute_elementwise(
    node: ir.Node,
    inputs: Sequence[ir.Value | None],
    rows: int,
    lookup: ColumnLookup,
    emit: EmitNode,
) -> Columns:
    """Evaluate an elementwise ONNX operator once for each column of its operands."""
    shape = required(fixed_shape(node.outputs[0]))
    trailing_shape = shape[1:]
    arrays = [
        np.full(trailing_shape, None, object)
        if value is None
        else np.broadcast_to(_columns_of_operand(value, shape, rows, lookup), trailing_shape)
        for value in inputs
    ]
    attributes = attribute_values(node)
    results = np.empty(trailing_shape, object)
    for index in np.ndindex(*trailing_shape):
        operands = [array[index] for array in arrays]
        if is_op(node, "Max", "Min"):
            results[index] = reduce(lambda a, b: emit(node.op_type, [a, b], {}), operands)
        else:
            results[index] = emit(node.op_type, operands, attributes)
    return results


def _columns_of_operand(
    value: ir.Value, shape: tuple[int, ...], rows: int, lookup: ColumnLookup
) -> Columns:
    value_shape = required(fixed_shape(value))
    if len(value_shape) == len(shape) and value_shape and value_shape[0] == rows:
        return lookup(value)
    known = constant_of(value)
    if prod(value_shape) == 1:  # Case 2: one number, which may vary from frame to frame
        single_column = np.empty((), object)
        single_column[()] = value if known is None else known.reshape(-1)[0]
        return single_column
    assert known is not None
    trailing_shape = value_shape[1:] if len(value_shape) == len(shape) else value_shape
    numbers = np.empty(prod(trailing_shape), object)
    numbers[:] = list(known.reshape(-1))
    return numbers.reshape(trailing_shape)


def _compute_reduction(node: ir.Node, columns: Columns, emit: EmitNode) -> Columns:
    axes = [axis - 1 for axis in reduction_axes(node, columns.ndim + 1)]
    remaining_axes = [axis for axis in range(columns.ndim) if axis not in axes]
    rows = columns.transpose(remaining_axes + axes)
    flat = rows.reshape(prod(rows.shape[: len(remaining_axes)]), -1)
    totals = np.empty(len(flat), object)
    squares = is_op(node, "ReduceL2")
    for index, parts in enumerate(flat):
        terms = [emit("Mul", [part, part], {}) for part in parts] if squares else list(parts)
        total = reduce(lambda a, b: emit(_OPERATOR_BY_REDUCTION[node.op_type], [a, b], {}), terms)
        totals[index] = emit("Sqrt", [total], {}) if squares else total
    return totals


def reduction_axes(node: ir.Node, rank: int) -> list[int]:
    """Return the axes that a reduction node reduces; an empty list if unknown."""
    attribute = node.attributes.get("axes")
    if attribute is not None:
        return [axis % rank for axis in attribute.as_ints()]
    known = constant_of(node.inputs[1]) if len(node.inputs) > 1 else None
    return [] if known is None else [int(axis) % rank for axis in known.reshape(-1)]


def _slices_of_node(node: ir.Node, rank: int) -> tuple[slice, ...] | None:
    """Return the ranges of a Slice on axes after the first; None if it slices the first axis."""
    arguments = [constant_of(value) for value in node.inputs[1:] if value is not None]
    if len(arguments) != len(node.inputs) - 1 or any(array is None for array in arguments):
        return None
    slice_starts, ends, axes, steps = (*arguments, None, None)[:4]
    assert slice_starts is not None
    assert ends is not None
    axes = np.arange(len(slice_starts)) if axes is None else axes
    steps = np.ones(len(slice_starts), np.int64) if steps is None else steps
    slices = [slice(None)] * (rank - 1)
    for begin, end, axis, step in zip(slice_starts, ends, axes, steps, strict=True):
        if int(axis) % rank == 0 or step < 1:
            return None
        slices[int(axis) % rank - 1] = slice(int(begin), int(end), int(step))
    return tuple(slices)
