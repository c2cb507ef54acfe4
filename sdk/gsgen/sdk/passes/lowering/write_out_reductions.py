"""Reductions, written out with the plainest of them."""

__all__ = ["WriteOutReductions"]

from collections.abc import Callable
from functools import partial
from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, Substitute
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, int_attribute

# From these operator sets on, axes are an argument; before, an attribute.
_SUM_TAKES_AXES, _ALL_TAKE_AXES = 13, 18


class WriteOutReductions(Substitute):
    """Write composite reductions with ReduceSum and ReduceMax.

    ReduceSum, ReduceMean, ReduceMax and ReduceMin have kernels wherever reductions have any; the
    others are made of them::

        ReduceL2(x)   →   Sqrt(ReduceSum(x · x))
    """

    name: ClassVar[str] = "write-out-reductions"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=1e-6)
    kinds: ClassVar[frozenset[str]] = frozenset(
        {"ReduceL1", "ReduceL2", "ReduceLogSum", "ReduceLogSumExp", "ReduceSumSquare"}
    )

    def suits(self, node: ir.Node) -> bool:
        """Say whether it is of floats, and really reduces."""
        value = node.inputs[0]
        idle = int_attribute(node, "noop_with_empty_axes", 0)
        axes = constant_of(node.inputs[1]) if len(node.inputs) > 1 else None
        floats = (
            value is not None
            and value.dtype is not None
            and value.dtype.is_floating_point()
        )
        return floats and (not idle or (axes is not None and axes.size > 0))

    def replace(self, node: ir.Node) -> None:
        """Write the reduction out, over the same axes."""
        write, x = InsertionPoint(node), node.inputs[0]
        assert x is not None
        reduced = partial(_reduced, write, node, self.opset)
        match node.op_type:
            case "ReduceL1":
                made = reduced("ReduceSum", write.op("Abs", x))
            case "ReduceL2":
                made = write.op("Sqrt", reduced("ReduceSum", write.op("Mul", x, x)))
            case "ReduceSumSquare":
                made = reduced("ReduceSum", write.op("Mul", x, x))
            case "ReduceLogSum":
                made = write.op("Log", reduced("ReduceSum", x))
            case _:
                made = _log_sum_exp(write, x, reduced)
        write.replace(made)


def _log_sum_exp(
    write: InsertionPoint, x: ir.Value, reduced: Callable[..., ir.Value]
) -> ir.Value:
    """Subtract the largest number first, unless it is infinite: e to a large power is."""
    assert x.dtype is not None
    kind = x.dtype.numpy()
    zero = write.constant(np.zeros((), kind))
    endless = write.constant(np.asarray(np.inf, kind))

    def usable(largest: ir.Value) -> ir.Value:
        finite = write.op("Less", write.op("Abs", largest), endless, dtype=ir.DataType.BOOL)
        return write.op("Where", finite, largest, zero, dtype=x.dtype)

    kept = usable(reduced("ReduceMax", x, keep=1))
    powers = write.op("Exp", write.op("Sub", x, kept))
    shift = usable(reduced("ReduceMax", x))
    return write.op("Add", write.op("Log", reduced("ReduceSum", powers)), shift)


def _reduced(
    write: InsertionPoint,
    node: ir.Node,
    opset: int,
    kind: str,
    value: ir.Value,
    keep: int | None = None,
) -> ir.Value:
    """Reduce ``value`` along the axes of ``node``, given the way the operator set wants them."""
    keep = int_attribute(node, "keepdims", 1) if keep is None else keep
    attribute = node.attributes.get("axes")
    axes = None if attribute is None else list(attribute.as_ints())
    given = node.inputs[1] if len(node.inputs) > 1 else None
    if opset >= (_SUM_TAKES_AXES if kind == "ReduceSum" else _ALL_TAKE_AXES):
        argument = write.whole(*axes) if axes is not None else given
        return write.op(
            kind, value, *([argument] if argument is not None else []), keepdims=keep
        )
    if axes is None:
        return write.op(kind, value, keepdims=keep)
    return write.op(kind, value, keepdims=keep, axes=axes)
