"""Operators that treat every row by itself, so that they may treat all rows, kept or not.

Each function returns the rows that a node gives, or None where it may mix rows.
"""

__all__ = ["axes_of", "moved_rows", "split_rows"]

from collections.abc import Callable, Sequence
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

_EACH = frozenset(
    {
        *(
            "Abs",
            "Acos",
            "Acosh",
            "Add",
            "And",
            "Asin",
            "Asinh",
            "Atan",
            "Atanh",
            "Cast",
            "Ceil",
        ),
        *(
            "Clip",
            "Cos",
            "Cosh",
            "Div",
            "Elu",
            "Equal",
            "Erf",
            "Exp",
            "Floor",
            "Gelu",
            "Greater",
        ),
        *(
            "GreaterOrEqual",
            "HardSigmoid",
            "HardSwish",
            "Identity",
            "IsInf",
            "IsNaN",
            "LeakyRelu",
        ),
        *(
            "Less",
            "LessOrEqual",
            "Log",
            "Max",
            "Mean",
            "Min",
            "Mish",
            "Mod",
            "Mul",
            "Neg",
            "Not",
        ),
        *(
            "Or",
            "Pow",
            "Reciprocal",
            "Relu",
            "Round",
            "Selu",
            "Sigmoid",
            "Sign",
            "Sin",
            "Sinh",
        ),
        *("Softplus", "Softsign", "Sqrt", "Sub", "Sum", "Tan", "Tanh", "Where", "Xor"),
    }
)
_ALONG = frozenset({"ArgMax", "ArgMin", "CumSum", "Hardmax", "LogSoftmax", "Softmax"})
_FOREVER = (1 << 31) - 1
_FLOATS = (ir.DataType.FLOAT, ir.DataType.FLOAT16, ir.DataType.DOUBLE)

Facts = Sequence[Fact | None]


def moved_rows(node: ir.Node, facts: Facts, draft: RowDraft) -> Rows | None:
    """Return the rows that ``node`` gives, all N of them drafted."""
    if any(isinstance(fact, Rows) and fact.flat for fact in facts):
        return None
    if node.op_type in _EACH:
        return _each(node, facts, draft)
    if is_op(node, "Concat"):
        return _joined(node, facts, draft)
    if is_op(node, "MatMul", "Gemm"):
        return _product(node, facts, draft)
    if is_op(node, "Einsum"):
        return _summed(node, facts, draft)
    rows = facts[0]
    if not isinstance(rows, Rows) or any(isinstance(fact, Rows) for fact in facts[1:]):
        return None
    found = _OF_ONE.get(node.op_type)
    return None if found is None else found(node, rows, facts, draft)


def _relay(
    node: ir.Node, inputs: Sequence[ir.Value | None], axis: int, rows: Rows, draft: RowDraft
) -> Rows | None:
    """Draft ``node`` on all rows; its result has N where it had K."""
    shape = _shape_with(node.outputs[0], axis, rows)
    if shape is None or len(node.outputs) != 1:
        return None
    (made,) = draft.like(node, inputs)
    made.shape = ir.Shape(shape)
    return Rows(rows.mask, made, axis)


def _shape_with(value: ir.Value, axis: int, rows: Rows) -> list[int] | None:
    dims = list(value.shape) if value.shape is not None else None
    if dims is None or not 0 <= axis < len(dims):
        return None
    dims[axis] = rows.mask.size
    return (
        [dim for dim in dims if isinstance(dim, int)]
        if all(isinstance(d, int) for d in dims)
        else None
    )


def _inputs(node: ir.Node, facts: Facts) -> list[ir.Value | None]:
    return [
        fact.value if isinstance(fact, Rows) else value
        for value, fact in zip(node.inputs, facts, strict=True)
    ]


def _each(node: ir.Node, facts: Facts, draft: RowDraft) -> Rows | None:
    """Elementwise operators: rows must meet rows, and what is not rows be the same for all."""
    given = [fact for fact in facts if isinstance(fact, Rows)]
    from_behind = {fact.axis - (rank_of(fact.value) or 0) for fact in given}
    rank = rank_of(node.outputs[0])
    if (
        len(from_behind) != 1
        or rank is None
        or any(isinstance(f, Index | Filler) for f in facts)
    ):
        return None
    (behind,) = from_behind
    inputs = _inputs(node, facts)
    for place, (value, fact) in enumerate(zip(node.inputs, facts, strict=True)):
        if isinstance(fact, Linear) and value is not None:
            inputs[place] = value = draft.number(fact, value)
        if value is None or isinstance(fact, Rows):
            continue
        if value.shape is None:
            return None
        if len(value.shape) >= -behind and value.shape[behind] != 1:
            return None
    divides = is_op(node, "Div", "Mod") and node.outputs[0].dtype not in _FLOATS
    if divides:  # a row that is not kept might divide by zero, which stops the runtime
        known = constant_of(node.inputs[1])
        if known is None or not known.all():
            return None
    return _relay(node, inputs, rank + behind, given[0], draft)


def _joined(node: ir.Node, facts: Facts, draft: RowDraft) -> Rows | None:
    rows = facts[0]
    if not isinstance(rows, Rows) or not all(isinstance(fact, Rows) for fact in facts):
        return None
    axis = node.attributes["axis"].as_int() % (rank_of(rows.value) or 1)
    same = all(isinstance(fact, Rows) and fact.axis == rows.axis for fact in facts)
    if axis == rows.axis or not same:
        return None
    return _relay(node, _inputs(node, facts), rows.axis, rows, draft)


def _product(node: ir.Node, facts: Facts, draft: RowDraft) -> Rows | None:
    """Products that contract along other axes than that of the rows."""
    given = [fact for fact in facts if isinstance(fact, Rows)]
    if len(given) != sum(fact is not None for fact in facts) or not given:
        return None
    place = _gemm_place(node, facts) if is_op(node, "Gemm") else _matmul_place(node, facts)
    return (
        None
        if place is None
        else _relay(node, _inputs(node, facts), place, given[0], draft)
    )


def _gemm_place(node: ir.Node, facts: Facts) -> int | None:
    rows = facts[0]
    added = node.inputs[2] if len(node.inputs) > 2 else None
    same = added is None or rank_of(added) in (0, 1) or (added.shape or [0])[0] == 1
    if not isinstance(rows, Rows) or any(facts[1:]) or rows.axis != 0 or not same:
        return None
    return None if int_attribute(node, "transA", 0) else 0


def _matmul_place(node: ir.Node, facts: Facts) -> int | None:
    """Return the rows' axis in a product; stacks of matrices must be stacked by the same rows."""
    values = _inputs(node, facts)
    ranks, made = [rank_of(value) for value in values], rank_of(node.outputs[0])
    if None in ranks or made is None or 1 in ranks:
        rows = facts[0]
        plain = isinstance(rows, Rows) and facts[1] is None and ranks[1] == 1
        return (
            rows.axis
            if plain and isinstance(rows, Rows) and rows.axis + 1 < (ranks[0] or 0)
            else None
        )
    behind = {
        fact.axis - (rank or 0)
        for fact, rank in zip(facts, ranks, strict=True)
        if isinstance(fact, Rows)
    }
    if len(behind) != 1:
        return None
    (axis,) = behind
    if axis > -3:  # rows of the left matrix, or columns of the right one
        side = 0 if axis == -2 else 1
        alone = isinstance(facts[side], Rows) and facts[1 - side] is None
        return made + axis if alone else None
    for value, fact in zip(values, facts, strict=True):
        shape = value.shape if value is not None else None
        if fact is None and (shape is None or (len(shape) >= -axis and shape[axis] != 1)):
            return None
    return made + axis


def _summed(node: ir.Node, facts: Facts, draft: RowDraft) -> Rows | None:
    """Einsum, where the rows have a letter of their own that the result keeps."""
    given = [fact for fact in facts if isinstance(fact, Rows)]
    left, arrow, right = (
        node.attributes["equation"].as_string().replace(" ", "").partition("->")
    )
    terms = left.split(",")
    if not arrow or "." in left + right or len(terms) != len(facts) or not given:
        return None
    letters = {
        term[fact.axis]
        for term, fact in zip(terms, facts, strict=True)
        if isinstance(fact, Rows)
    }
    others = "".join(
        t for t, fact in zip(terms, facts, strict=True) if not isinstance(fact, Rows)
    )
    if len(letters) != 1 or any(fact is not None and fact not in given for fact in facts):
        return None
    (letter,) = letters
    once = all(term.count(letter) <= 1 for term in terms) and right.count(letter) == 1
    if not once or letter in others:
        return None
    return _relay(node, _inputs(node, facts), right.index(letter), given[0], draft)


# -- Operators of one tensor of rows


def _cut(node: ir.Node, rows: Rows, facts: Facts, draft: RowDraft) -> Rows | None:
    """Slice along other axes, or along all rows."""
    arrays = [constant_of(value) for value in node.inputs[1:]]
    if any(array is None for array in arrays) or len(arrays) < 2:
        return None
    starts, ends, *rest = [array.reshape(-1) for array in arrays if array is not None]
    rank = rank_of(rows.value) or 1
    axes = rest[0] % rank if rest else np.arange(len(starts))
    steps = rest[1] if len(rest) > 1 else np.ones(len(starts), np.int64)
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        if axis == rows.axis and not (start == 0 and end >= _FOREVER and step == 1):
            return None
    return _relay(node, [rows.value, *node.inputs[1:]], rows.axis, rows, draft)


def _picked(node: ir.Node, rows: Rows, facts: Facts, draft: RowDraft) -> Rows | None:
    """Gather along another axis."""
    rank = rank_of(rows.value) or 1
    axis, index = int_attribute(node, "axis", 0) % rank, rank_of(node.inputs[1])
    if axis == rows.axis or index is None or facts[1] is not None:
        return None
    place = rows.axis + (index - 1 if axis < rows.axis else 0)
    return _relay(node, [rows.value, *node.inputs[1:]], place, rows, draft)


def axes_of(node: ir.Node) -> list[int] | None:
    """Return the axes of a node that has them as an attribute or as its second input."""
    if "axes" in node.attributes:
        return [int(axis) for axis in node.attributes["axes"].as_ints()]
    known = constant_of(node.inputs[1]) if len(node.inputs) > 1 else None
    return None if known is None else [int(axis) for axis in known.reshape(-1)]


def _reduced(node: ir.Node, rows: Rows, facts: Facts, draft: RowDraft) -> Rows | None:
    axes, rank = axes_of(node), rank_of(rows.value) or 1
    if not axes:
        return None
    places = {axis % rank for axis in axes}
    if rows.axis in places:
        return None
    gone = 0 if int_attribute(node, "keepdims", 1) else sum(p < rows.axis for p in places)
    return _relay(node, [rows.value, *node.inputs[1:]], rows.axis - gone, rows, draft)


def _along(node: ir.Node, rows: Rows, facts: Facts, draft: RowDraft) -> Rows | None:
    rank = rank_of(rows.value) or 1
    if is_op(node, "CumSum"):
        known = constant_of(node.inputs[1])
        axis = None if known is None else int(known.reshape(-1)[0]) % rank
    else:
        axis = (
            int_attribute(node, "axis", 0 if is_op(node, "ArgMax", "ArgMin") else -1) % rank
        )
    if axis is None or axis == rows.axis:
        return None
    drops = is_op(node, "ArgMax", "ArgMin") and not int_attribute(node, "keepdims", 1)
    place = rows.axis - (1 if drops and axis < rows.axis else 0)
    return _relay(node, [rows.value, *node.inputs[1:]], place, rows, draft)


def _squeezed(node: ir.Node, rows: Rows, facts: Facts, draft: RowDraft) -> Rows | None:
    axes, rank = axes_of(node), rank_of(rows.value) or 1
    if axes is None or rows.axis in {axis % rank for axis in axes}:
        return None
    place = rows.axis - sum(axis % rank < rows.axis for axis in axes)
    return _relay(node, [rows.value, *node.inputs[1:]], place, rows, draft)


def _unsqueezed(node: ir.Node, rows: Rows, facts: Facts, draft: RowDraft) -> Rows | None:
    axes, rank = axes_of(node), rank_of(node.outputs[0])
    if axes is None or rank is None:
        return None
    added = {axis % rank for axis in axes}
    place = [axis for axis in range(rank) if axis not in added][rows.axis]
    return _relay(node, [rows.value, *node.inputs[1:]], place, rows, draft)


def _transposed(node: ir.Node, rows: Rows, facts: Facts, draft: RowDraft) -> Rows | None:
    rank = rank_of(rows.value) or 1
    order = node.attributes.get("perm")
    axes = list(range(rank))[::-1] if order is None else list(order.as_ints())
    return _relay(node, [rows.value], axes.index(rows.axis), rows, draft)


def _reshaped(node: ir.Node, rows: Rows, facts: Facts, draft: RowDraft) -> Rows | None:
    """Reshape what follows the rows; or flatten all, which only a scatter may read."""
    shape, rank = fixed_shape(rows.value), rank_of(node.outputs[0])
    if shape is None or rank is None or rows.axis != 0:
        return None
    wanted = _wanted_shape(node, facts)
    if wanted is None:
        return None
    if wanted == [-1] and len(shape) > 1:
        return Rows(rows.mask, rows.value, 0, flat=True)
    if not wanted or wanted[0] != -1:
        return None
    rest = [
        shape[place] if size == 0 and not int_attribute(node, "allowzero", 0) else size
        for place, size in enumerate(wanted)
    ][1:]
    if prod(rest) != prod(shape[1:]) or min(rest, default=1) < 0:
        return None
    return Rows(rows.mask, draft.reshaped(rows.value, [rows.mask.size, *rest]), 0)


def _wanted_shape(node: ir.Node, facts: Facts) -> list[int] | None:
    """Return the target of a Reshape, with −1 where the rows go."""
    target = facts[1] if len(facts) > 1 else None
    if isinstance(target, Linear):
        front = target.factor[:1].tolist() == [1] and target.constant[0] == 0
        if not front or target.factor[1:].any():
            return None
        return [-1, *(int(size) for size in target.constant[1:])]
    known = constant_of(node.inputs[1])
    if known is None:
        return None
    sizes = [int(size) for size in known]
    if sizes[:1] == [0] and not int_attribute(node, "allowzero", 0):
        if -1 in sizes:
            shape = fixed_shape(facts[0].value) if isinstance(facts[0], Rows) else None
            others = prod(size for size in sizes[1:] if size > 0)
            if shape is None or 0 in sizes[1:] or not others:
                return None
            sizes[sizes.index(-1)] = prod(shape[1:]) // others
        sizes[0] = -1
    return sizes


def _expanded(node: ir.Node, rows: Rows, facts: Facts, draft: RowDraft) -> Rows | None:
    """Expand along other axes."""
    target, shape = facts[1], fixed_shape(rows.value)
    if not isinstance(target, Linear) or shape is None or target.factor.sum() != 1:
        known = constant_of(node.inputs[1])
        if known is None or shape is None or len(known) > len(shape):
            return None
        sizes = [int(size) for size in known]
        place = rows.axis - (len(shape) - len(sizes))
        if place >= 0 and sizes[place] != 1:
            return None
    else:
        sizes = [int(size) for size in target.constant]
        place = int(np.argmax(target.factor))
        if (
            sizes[place]
            or place - len(sizes) != rows.axis - len(shape)
            or (target.factor < 0).any()
        ):
            return None
        sizes[place] = rows.mask.size
    whole = [int(size) for size in np.broadcast_shapes(shape, tuple(sizes))]
    axis = rows.axis + len(whole) - len(shape)
    made = draft.op("Expand", rows.value, draft.constant(whole, np.int64), shape=whole)
    return Rows(rows.mask, made, axis)


_Move = Callable[[ir.Node, Rows, Facts, RowDraft], Rows | None]
_OF_ONE: dict[str, _Move] = {
    "Expand": _expanded,
    "Gather": _picked,
    "Reshape": _reshaped,
    "Slice": _cut,
    "Squeeze": _squeezed,
    "Transpose": _transposed,
    "Unsqueeze": _unsqueezed,
    **dict.fromkeys(_ALONG, _along),
    **dict.fromkeys(
        (
            *("ReduceL1", "ReduceL2", "ReduceLogSum", "ReduceLogSumExp", "ReduceMax"),
            *("ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum", "ReduceSumSquare"),
        ),
        _reduced,
    ),
}


def split_rows(node: ir.Node, facts: Facts, draft: RowDraft) -> list[Rows] | None:
    """Return what Split gives along another axis than that of the rows."""
    rows = facts[0]
    if not isinstance(rows, Rows) or rows.flat or any(facts[1:]):
        return None
    shapes = [_shape_with(value, rows.axis, rows) for value in node.outputs]
    axis = int_attribute(node, "axis", 0) % (rank_of(rows.value) or 1)
    if axis == rows.axis or any(shape is None for shape in shapes):
        return None
    made = draft.like(node, [rows.value, *node.inputs[1:]])
    for value, shape in zip(made, shapes, strict=True):
        value.shape = ir.Shape(shape or ())
    return [Rows(rows.mask, value, rows.axis) for value in made]
