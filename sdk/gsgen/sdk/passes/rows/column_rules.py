"""What operators do to the columns of long, narrow tensors.

A tensor [rows, a, b, …] is an array [a, b, …] of columns: what an operator does to the axes behind
the first, numpy does to that array.
"""

__all__ = ["Columns", "Emit", "columns_of", "handles"]

from collections.abc import Callable, Sequence
from functools import reduce
from math import prod
from typing import Any

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import (
    constant_of,
    fixed_shape,
    int_attribute,
    split_sizes,
)

Columns = np.ndarray[Any, np.dtype[np.object_]]
# Writes one operator of columns and returns its result; numbers may stand among the operands.
Emit = Callable[[str, Sequence[Any], dict[str, Any]], Any]
Look = Callable[[ir.Value], Columns]

_EACH = frozenset(
    {
        *(
            "Abs",
            "Add",
            "And",
            "Cast",
            "Ceil",
            "Clip",
            "Cos",
            "Div",
            "Equal",
            "Exp",
            "Floor",
        ),
        *(
            "Greater",
            "GreaterOrEqual",
            "Less",
            "LessOrEqual",
            "Log",
            "Max",
            "Min",
            "Mul",
            "Neg",
        ),
        *(
            "Not",
            "Or",
            "Reciprocal",
            "Relu",
            "Sigmoid",
            "Sin",
            "Sqrt",
            "Sub",
            "Tanh",
            "Where",
        ),
    }
)
_REDUCTIONS = {
    "ReduceL2": "Add",
    "ReduceMax": "Max",
    "ReduceMin": "Min",
    "ReduceSum": "Add",
}
_SHAPERS = ("Expand", "Reshape", "Squeeze", "Unsqueeze")


def handles(node: ir.Node, rows: int) -> bool:
    """Say whether ``node``, which returns ``rows`` rows, works on columns alone."""
    if is_op(node, *_EACH):
        return all(
            value is None or _may_be_operand(value, node, rows) for value in node.inputs
        )
    first = node.inputs[0] if node.inputs else None
    shape = fixed_shape(first)
    if not shape or shape[0] != rows:
        return False
    if is_op(node, *_REDUCTIONS):
        axes = _axes(node, len(shape))
        return bool(axes) and 0 not in axes
    if is_op(node, *_SHAPERS):
        return True
    if is_op(node, "Concat"):
        return int_attribute(node, "axis", 0) % len(shape) > 0
    if is_op(node, "Transpose"):
        perm = node.attributes.get("perm")
        return perm is not None and next(iter(perm.as_ints())) == 0
    if is_op(node, "Gather"):
        return int_attribute(node, "axis", 0) % len(shape) > 0 and _known(node.inputs[1:])
    if is_op(node, "Slice"):
        return _cuts(node, len(shape)) is not None
    if is_op(node, "Split"):
        return (
            int_attribute(node, "axis", 0) % len(shape) > 0
            and split_sizes(node) is not None
        )
    return False


def columns_of(
    node: ir.Node, inputs: Sequence[ir.Value | None], rows: int, look: Look, emit: Emit
) -> list[Columns]:
    """Return the columns of each result of ``node``.

    Args:
        node: One that :func:`handles` is true of.
        inputs: Its arguments, before anything was rewritten.
        rows: How many rows it works on.
        look: Gives the columns of a tensor that has as many rows.
        emit: Writes an operator.
    """
    if is_op(node, *_EACH):
        return [_each(node, inputs, rows, look, emit)]
    first = inputs[0]
    assert first is not None
    taken, shape = look(first), fixed_shape(node.outputs[0])
    assert shape is not None
    if is_op(node, *_REDUCTIONS):
        return [_reduced(node, taken, emit).reshape(shape[1:])]
    if is_op(node, "Expand"):
        return [np.broadcast_to(taken, shape[1:])]
    if is_op(node, *_SHAPERS):
        return [taken.reshape(shape[1:])]
    axis = int_attribute(node, "axis", 0) % (taken.ndim + 1) - 1
    if is_op(node, "Concat"):
        return [
            np.concatenate([look(value) for value in inputs if value is not None], axis)
        ]
    if is_op(node, "Transpose"):
        perm = node.attributes["perm"].as_ints()
        return [taken.transpose([place - 1 for place in list(perm)[1:]])]
    if is_op(node, "Gather"):
        places = constant_of(inputs[1])
        assert places is not None
        shape = fixed_shape(node.outputs[0])
        assert shape is not None
        made = np.empty(shape[1:], object)
        made[...] = np.take(taken, places, axis)  # of one place it is no array
        return [made]
    if is_op(node, "Slice"):
        cuts = _cuts(node, taken.ndim + 1)
        assert cuts is not None
        return [taken[cuts]]
    sizes = split_sizes(node)
    assert sizes is not None
    return list(np.split(taken, np.cumsum(sizes)[:-1], axis))


def _may_be_operand(value: ir.Value, node: ir.Node, rows: int) -> bool:
    """Say whether ``value`` has a column for each row, or one number for all."""
    shape, made = fixed_shape(value), fixed_shape(node.outputs[0])
    if shape is None or made is None:
        return False
    if len(shape) == len(made) and shape and shape[0] == rows:
        return True
    if prod(shape) == 1:
        return True
    # Constant numbers, one for each column.
    flat = len(shape) < len(made) or shape[0] == 1
    return flat and constant_of(value) is not None


def _each(
    node: ir.Node, inputs: Sequence[ir.Value | None], rows: int, look: Look, emit: Emit
) -> Columns:
    """Write an operator that works element by element, once a column."""
    shape = fixed_shape(node.outputs[0])
    assert shape is not None
    trailing = shape[1:]
    arrays = [
        np.full(trailing, None, object)
        if value is None
        else np.broadcast_to(_operand(value, shape, rows, look), trailing)
        for value in inputs
    ]
    attributes = {key: one.value for key, one in node.attributes.items()}
    made = np.empty(trailing, object)
    for place in np.ndindex(*trailing):
        operands = [array[place] for array in arrays]
        if is_op(node, "Max", "Min"):
            made[place] = reduce(lambda a, b: emit(node.op_type, [a, b], {}), operands)
        else:
            made[place] = emit(node.op_type, operands, attributes)
    return made


def _operand(value: ir.Value, shape: tuple[int, ...], rows: int, look: Look) -> Columns:
    own = fixed_shape(value)
    assert own is not None
    if len(own) == len(shape) and own and own[0] == rows:
        return look(value)
    known = constant_of(value)
    if prod(own) == 1:  # one number; it may vary from frame to frame
        single = np.empty((), object)
        single[()] = value if known is None else known.reshape(-1)[0]
        return single
    assert known is not None
    trailing = own[1:] if len(own) == len(shape) else own
    made = np.empty(prod(trailing), object)
    made[:] = list(known.reshape(-1))
    return made.reshape(trailing)


def _reduced(node: ir.Node, taken: Columns, emit: Emit) -> Columns:
    axes = [axis - 1 for axis in _axes(node, taken.ndim + 1)]
    others = [axis for axis in range(taken.ndim) if axis not in axes]
    rows = taken.transpose(others + axes)
    flat = rows.reshape(prod(rows.shape[: len(others)]), -1)
    made = np.empty(len(flat), object)
    squares = is_op(node, "ReduceL2")
    for index, parts in enumerate(flat):
        terms = [emit("Mul", [one, one], {}) for one in parts] if squares else list(parts)
        total = reduce(lambda a, b: emit(_REDUCTIONS[node.op_type], [a, b], {}), terms)
        made[index] = emit("Sqrt", [total], {}) if squares else total
    return made


def _axes(node: ir.Node, rank: int) -> list[int]:
    """Return the axes that a reduction is over; none where that is not known."""
    given = node.attributes.get("axes")
    if given is not None:
        return [axis % rank for axis in given.as_ints()]
    known = constant_of(node.inputs[1]) if len(node.inputs) > 1 else None
    return [] if known is None else [int(axis) % rank for axis in known.reshape(-1)]


def _known(values: Sequence[ir.Value | None]) -> bool:
    return all(constant_of(value) is not None for value in values)


def _cuts(node: ir.Node, rank: int) -> tuple[slice, ...] | None:
    """Return what a Slice takes of each axis behind the first; None where it takes of the first."""
    given = [constant_of(value) for value in node.inputs[1:] if value is not None]
    if len(given) != len(node.inputs) - 1 or any(array is None for array in given):
        return None
    begins, ends, axes, steps = (*given, None, None)[:4]
    assert begins is not None
    assert ends is not None
    axes = np.arange(len(begins)) if axes is None else axes
    steps = np.ones(len(begins), np.int64) if steps is None else steps
    cuts = [slice(None)] * (rank - 1)
    for begin, end, axis, step in zip(begins, ends, axes, steps, strict=True):
        if int(axis) % rank == 0 or step < 1:
            return None
        cuts[int(axis) % rank - 1] = slice(int(begin), int(end), int(step))
    return tuple(cuts)
