"""Rewrites composite reductions, such as ReduceL2, with ReduceSum and ReduceMax."""

__all__ = ["WriteOutReductions"]

from collections.abc import Callable
from functools import partial

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, SubstituteNodes
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, int_attribute, required

# From these operator sets on, the axes are an input; before, an attribute.
_SUM_AXES_OPSET, _ALL_AXES_OPSET = 13, 18


class WriteOutReductions(SubstituteNodes):
    """Replace composite reductions, such as ReduceL2, by ReduceSum and ReduceMax.

    Every release with kernels for reductions has ReduceSum, ReduceMean, ReduceMax and ReduceMin;
    the other reductions are composed of these::

        ReduceL2(x)   →   Sqrt(ReduceSum(x · x))
    """

    name = "write-out-reductions"
    exactness = ErrorBudget(relative=1e-6)
    kinds = frozenset(
        {"ReduceL1", "ReduceL2", "ReduceLogSum", "ReduceLogSumExp", "ReduceSumSquare"}
    )

    def can_replace(self, node: ir.Node) -> bool:
        """Return whether a node reduces floats over at least one axis."""
        value = node.inputs[0]
        is_noop_with_empty_axes = int_attribute(node, "noop_with_empty_axes", 0)
        axes = constant_of(node.inputs[1]) if len(node.inputs) > 1 else None
        floats = value is not None and value.dtype is not None and value.dtype.is_floating_point()
        return floats and (not is_noop_with_empty_axes or (axes is not None and axes.size > 0))

    def replace(self, node: ir.Node) -> None:
        """Replace a composite reduction by its formula with ReduceSum or ReduceMax."""
        write, x = InsertionPoint(node), required(node.inputs[0])
        reduced = partial(_write_reduction, write, node, self.opset)
        match node.op_type:
            case "ReduceL1":
                result = reduced("ReduceSum", write.op("Abs", x))
            case "ReduceL2":
                result = write.op("Sqrt", reduced("ReduceSum", write.op("Mul", x, x)))
            case "ReduceSumSquare":
                result = reduced("ReduceSum", write.op("Mul", x, x))
            case "ReduceLogSum":
                result = write.op("Log", reduced("ReduceSum", x))
            case _:
                result = _log_sum_exp(write, x, reduced)
        write.replace(result)


def _log_sum_exp(write: InsertionPoint, x: ir.Value, reduced: Callable[..., ir.Value]) -> ir.Value:
    """Replace ReduceLogSumExp; the finite maximum is subtracted first, to avoid overflow."""
    assert x.dtype is not None
    kind = x.dtype.numpy()
    zero = write.constant(np.zeros((), kind))
    infinity = write.constant(np.asarray(np.inf, kind))

    def finite_or_zero(largest: ir.Value) -> ir.Value:
        finite = write.op("Less", write.op("Abs", largest), infinity, dtype=ir.DataType.BOOL)
        return write.op("Where", finite, largest, zero, dtype=x.dtype)

    largest_with_kept_axes = finite_or_zero(reduced("ReduceMax", x, keep_axes=1))
    exponentials = write.op("Exp", write.op("Sub", x, largest_with_kept_axes))
    reduced_maximum = finite_or_zero(reduced("ReduceMax", x))
    return write.op("Add", write.op("Log", reduced("ReduceSum", exponentials)), reduced_maximum)


def _write_reduction(
    write: InsertionPoint,
    node: ir.Node,
    opset: int,
    kind: str,
    value: ir.Value,
    keep_axes: int | None = None,
) -> ir.Value:
    """Insert a reduction along the axes of a node, in the form that the operator set requires."""
    keep_axes = int_attribute(node, "keepdims", 1) if keep_axes is None else keep_axes
    attribute = node.attributes.get("axes")
    axes = None if attribute is None else list(attribute.as_ints())
    axes_input = node.inputs[1] if len(node.inputs) > 1 else None
    if opset >= (_SUM_AXES_OPSET if kind == "ReduceSum" else _ALL_AXES_OPSET):
        argument = write.int64(*axes) if axes is not None else axes_input
        return write.op(
            kind, value, *([argument] if argument is not None else []), keepdims=keep_axes
        )
    if axes is None:
        return write.op(kind, value, keepdims=keep_axes)
    return write.op(kind, value, keepdims=keep_axes, axes=axes)
