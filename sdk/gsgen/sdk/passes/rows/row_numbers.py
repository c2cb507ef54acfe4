"""Shapes and counts that depend on the number of rows that a mask selects."""

__all__ = ["constant_rows", "linear_numbers", "mask_count", "shape_fact"]

from collections.abc import Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.shape_arithmetic import evaluate
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute
from gsgen.sdk.passes.rows.row_draft import RowDraft
from gsgen.sdk.passes.rows.row_facts import (
    Index,
    Linear,
    PaddingRowsFact,
    Rows,
    RowTensorFact,
    read_mask,
)

_INTEGER_DTYPES = (ir.DataType.INT32, ir.DataType.INT64)
_MOVE_OPERATORS = (
    "Cast",
    "Concat",
    "Gather",
    "Identity",
    "Reshape",
    "Slice",
    "Squeeze",
    "Unsqueeze",
)


def mask_count(node: ir.Node) -> Linear | None:
    """Return the number K of rows that a mask selects if a node sums the mask's elements."""
    source = node.inputs[0].producer() if node.inputs[0] is not None else None
    result_shape = fixed_shape(node.outputs[0])
    if (
        not is_op(source, "Cast")
        or node.outputs[0].dtype not in _INTEGER_DTYPES
        or result_shape is None
    ):
        return None
    mask = read_mask(_before_reshape(node.inputs[0]))
    if mask is None or mask.root.dtype != ir.DataType.BOOL or mask.repeats:
        return None
    mask_shape = fixed_shape(node.inputs[0])
    # If the mask has more than one element, a sum of one element is a sum over all.
    if mask_shape is None or np.prod(result_shape) != 1 or np.prod(mask_shape) == 1:
        return None
    return Linear(
        mask, np.zeros(result_shape, np.int64), np.ones(result_shape, np.int64), varies=False
    )


def _before_reshape(value: ir.Value | None) -> ir.Value | None:
    """Return the tensor of which casts and reshapes make a value: as many elements are true."""
    producer = value.producer() if value is not None else None
    while producer is not None and is_op(producer, "Cast", "Reshape"):
        value = producer.inputs[0]
        producer = value.producer() if value is not None else None
    return value


def shape_fact(node: ir.Node, fact: RowTensorFact) -> Linear | None:
    """Return a tensor's shape as formulas of K, the number of rows that a mask selects."""
    dims = _dims_of_fact(fact)
    end = node.attributes.get("end")
    start = int_attribute(node, "start", 0)
    sizes = dims[start : None if end is None else end.as_int()]
    if not sizes:
        return None
    constant = np.array([0 if dim is None else dim for dim in sizes], np.int64)
    factor = np.array([int(dim is None) for dim in sizes], np.int64)
    return Linear(fact.mask, constant, factor, varies=True)


def _dims_of_fact(fact: RowTensorFact) -> list[int | None]:
    """Return the sizes of a tensor, with None for the number K of selected rows."""
    if isinstance(fact, Rows) and not fact.flat:
        shape: list[int | None] = list(fixed_shape(fact.value) or ())
        shape[fact.axis] = None
        return shape
    if isinstance(fact, Index):
        axes = len(fact.mask.dims) + len(fact.mask.repeats)
        dims_by_form: dict[str, list[int | None]]
        dims_by_form = {"flat": [None], "rows": [None, axes], "columns": [axes, None]}
        return [] if fact.mask.repeats else dims_by_form[fact.index_form]
    return []


def linear_numbers(node: ir.Node, facts: Sequence[RowTensorFact | None]) -> Linear | None:
    """Return the result of arithmetic on shapes if it is linear in the selected row count K."""
    known = [fact for fact in facts if isinstance(fact, Linear)]
    if (
        len({fact.mask.without_repeats for fact in known}) != 1
        or node.outputs[0].dtype not in _INTEGER_DTYPES
    ):
        return None
    parts = [_parts(value, fact) for value, fact in zip(node.inputs, facts, strict=True)]
    full_shape = [part for part in parts if part is not None]
    if len(full_shape) != len(parts):
        return None
    varies = any(fact.varies for fact in known)
    if is_op(node, "Add", "Sub"):
        (a, b), (c, d) = full_shape
        sign = 1 if is_op(node, "Add") else -1
        constant, factor = np.broadcast_arrays(a + sign * c, b + sign * d)
        return Linear(known[0].mask, constant, factor, varies)
    if is_op(node, "Mul"):
        (a, b), (c, d) = full_shape
        if b.any() and d.any():
            return None
        constant, factor = np.broadcast_arrays(a * c, a * d + b * c)
        return Linear(known[0].mask, constant, factor, varies)
    is_concat = is_op(node, "Concat")
    if not is_op(node, *_MOVE_OPERATORS) or not (
        is_concat or (len(known) == 1 and facts[0] is known[0])
    ):
        return None
    arguments = [constant for constant, _ in full_shape[1:]]
    terms = [
        evaluate(
            node, [part[k] for part in full_shape] if is_concat else [full_shape[0][k], *arguments]
        )
        for k in (0, 1)
    ]
    if terms[0] is None or terms[1] is None:
        return None
    constant, factor = (array.astype(np.int64) for array in terms if array is not None)
    return Linear(known[0].mask, constant, factor, varies)


def _parts(
    value: ir.Value | None, fact: RowTensorFact | None
) -> tuple[np.ndarray, np.ndarray] | None:
    if isinstance(fact, Linear):
        return fact.constant, fact.factor
    known = constant_of(value)
    return None if known is None else (known, np.zeros_like(known))


def constant_rows(node: ir.Node, shape: Linear, draft: RowDraft) -> Rows | PaddingRowsFact | None:
    """Return the rows of a constant fill: one per selected row, or filler rows up to a capacity."""
    value = _constant_of_fill(node)
    sizes, factor = shape.constant, shape.factor
    if value is None or factor.ndim != 1 or value.ndim > len(sizes):
        return None
    value = value.reshape([1] * (len(sizes) - value.ndim) + list(value.shape))
    axis = int(np.argmax(np.abs(factor)))
    if value.shape[axis] != 1 or np.abs(factor).sum() != 1:
        return None
    if factor[axis] == 1 and sizes[axis] == 0:
        full_shape = [int(size) for size in sizes]
        full_shape[axis] = shape.mask.size
        source = draft.constant(value, value.dtype)
        target = draft.constant(full_shape, np.int64)
        return Rows(shape.mask, draft.op("Expand", source, target, shape=full_shape), axis)
    if factor[0] == -1:
        row = np.broadcast_to(value[0], np.broadcast_shapes(value.shape[1:], tuple(sizes[1:])))
        return PaddingRowsFact(shape.mask, int(sizes[0]), row)
    return None


def _constant_of_fill(node: ir.Node) -> np.ndarray | None:
    if is_op(node, "Expand"):
        return constant_of(node.inputs[0])
    attribute = node.attributes.get("value")
    array = np.zeros(1, np.float32) if attribute is None else attribute.as_tensor().numpy()
    return np.asarray(array).reshape(())
