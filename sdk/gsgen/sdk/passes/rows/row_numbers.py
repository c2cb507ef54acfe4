"""Shapes and counts that hang on how many rows a mask keeps."""

__all__ = ["count_of", "filled", "linear", "shape_fact"]

from collections.abc import Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.shape_arithmetic import evaluate
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute
from gsgen.sdk.passes.rows.row_draft import RowDraft
from gsgen.sdk.passes.rows.row_facts import Fact, Filler, Index, Linear, Rows, read_mask

_WHOLE = (ir.DataType.INT32, ir.DataType.INT64)
_MOVES = (
    "Cast",
    "Concat",
    "Gather",
    "Identity",
    "Reshape",
    "Slice",
    "Squeeze",
    "Unsqueeze",
)


def count_of(node: ir.Node) -> Linear | None:
    """Return K where ``node`` sums the whole of a mask of booleans."""
    source = node.inputs[0].producer() if node.inputs[0] is not None else None
    made = fixed_shape(node.outputs[0])
    if not is_op(source, "Cast") or node.outputs[0].dtype not in _WHOLE or made is None:
        return None
    mask = read_mask(node.inputs[0])
    if mask is None or mask.root.dtype != ir.DataType.BOOL or mask.behind:
        return None
    given = fixed_shape(node.inputs[0])
    # Of a mask of more elements than one, a sum that is one number is a sum over all.
    if given is None or np.prod(made) != 1 or np.prod(given) == 1:
        return None
    return Linear(mask, np.zeros(made, np.int64), np.ones(made, np.int64), varies=False)


def shape_fact(node: ir.Node, fact: Fact) -> Linear | None:
    """Return the numbers that Shape gives for rows or indices."""
    dims = _dims(fact)
    end = node.attributes.get("end")
    start = int_attribute(node, "start", 0)
    asked = dims[start : None if end is None else end.as_int()]
    if not asked:
        return None
    constant = np.array([0 if dim is None else dim for dim in asked], np.int64)
    factor = np.array([int(dim is None) for dim in asked], np.int64)
    return Linear(fact.mask, constant, factor, varies=True)


def _dims(fact: Fact) -> list[int | None]:
    """Return the sizes of a tensor; None stands for K."""
    if isinstance(fact, Rows) and not fact.flat:
        shape: list[int | None] = list(fixed_shape(fact.value) or ())
        shape[fact.axis] = None
        return shape
    if isinstance(fact, Index):
        axes = len(fact.mask.dims) + len(fact.mask.behind)
        forms: dict[str, list[int | None]]
        forms = {"flat": [None], "rows": [None, axes], "columns": [axes, None]}
        return [] if fact.mask.behind else forms[fact.form]
    return []


def linear(node: ir.Node, facts: Sequence[Fact | None]) -> Linear | None:
    """Return what arithmetic on shapes gives."""
    known = [fact for fact in facts if isinstance(fact, Linear)]
    if len({fact.mask.bare for fact in known}) != 1 or node.outputs[0].dtype not in _WHOLE:
        return None
    parts = [_parts(value, fact) for value, fact in zip(node.inputs, facts, strict=True)]
    whole = [part for part in parts if part is not None]
    if len(whole) != len(parts):
        return None
    varies = any(fact.varies for fact in known)
    if is_op(node, "Add", "Sub"):
        (a, b), (c, d) = whole
        sign = 1 if is_op(node, "Add") else -1
        constant, factor = np.broadcast_arrays(a + sign * c, b + sign * d)
        return Linear(known[0].mask, constant, factor, varies)
    if is_op(node, "Mul"):
        (a, b), (c, d) = whole
        if b.any() and d.any():
            return None
        constant, factor = np.broadcast_arrays(a * c, a * d + b * c)
        return Linear(known[0].mask, constant, factor, varies)
    joins = is_op(node, "Concat")
    if not is_op(node, *_MOVES) or not (
        joins or (len(known) == 1 and facts[0] is known[0])
    ):
        return None
    others = [constant for constant, _ in whole[1:]]
    made = [
        evaluate(node, [part[k] for part in whole] if joins else [whole[0][k], *others])
        for k in (0, 1)
    ]
    if made[0] is None or made[1] is None:
        return None
    constant, factor = (array.astype(np.int64) for array in made if array is not None)
    return Linear(known[0].mask, constant, factor, varies)


def _parts(
    value: ir.Value | None, fact: Fact | None
) -> tuple[np.ndarray, np.ndarray] | None:
    if isinstance(fact, Linear):
        return fact.constant, fact.factor
    known = constant_of(value)
    return None if known is None else (known, np.zeros_like(known))


def filled(node: ir.Node, shape: Linear, draft: RowDraft) -> Rows | Filler | None:
    """Return rows of a constant: as many as are kept, or as many as are missing."""
    value = _filler(node)
    sizes, factor = shape.constant, shape.factor
    if value is None or factor.ndim != 1 or value.ndim > len(sizes):
        return None
    value = value.reshape([1] * (len(sizes) - value.ndim) + list(value.shape))
    axis = int(np.argmax(np.abs(factor)))
    if value.shape[axis] != 1 or np.abs(factor).sum() != 1:
        return None
    if factor[axis] == 1 and sizes[axis] == 0:
        whole = [int(size) for size in sizes]
        whole[axis] = shape.mask.size
        source = draft.constant(value, value.dtype)
        target = draft.constant(whole, np.int64)
        return Rows(shape.mask, draft.op("Expand", source, target, shape=whole), axis)
    if factor[0] == -1:
        row = np.broadcast_to(
            value[0], np.broadcast_shapes(value.shape[1:], tuple(sizes[1:]))
        )
        return Filler(shape.mask, int(sizes[0]), row)
    return None


def _filler(node: ir.Node) -> np.ndarray | None:
    if is_op(node, "Expand"):
        return constant_of(node.inputs[0])
    given = node.attributes.get("value")
    array = np.zeros(1, np.float32) if given is None else given.as_tensor().numpy()
    return np.asarray(array).reshape(())
