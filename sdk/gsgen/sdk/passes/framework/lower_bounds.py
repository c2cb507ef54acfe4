"""Lower bounds of the values inside an ONNX graph, derived from its operators."""

__all__ = ["is_never_zero", "lower_bound", "smallest_normal"]

import math

import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.units import FLOAT16_SMALLEST_NORMAL
from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import constant_of

_BOUND_KEEPING_OPERATORS = (
    *("Cast", "Expand", "Flatten", "Gather", "Identity", "Reshape", "Slice", "Squeeze"),
    *("Transpose", "Unsqueeze", "ReduceMax", "ReduceMean", "ReduceMin", "Split"),
)
_NONNEGATIVE_OPERATORS = (
    *("Abs", "Exp", "ReduceL1", "ReduceL2", "ReduceSumSquare", "Sigmoid", "Softmax"),
    *("Softplus", "HardSigmoid"),
)
_MAX_DEPTH = 40


def smallest_normal(dtype: ir.DataType | None) -> float:
    """Return the smallest normal number of ``dtype``; GPUs may flush smaller ones to zero."""
    return {ir.DataType.FLOAT16: FLOAT16_SMALLEST_NORMAL, ir.DataType.DOUBLE: 2.0**-1022}.get(
        dtype or ir.DataType.FLOAT, 2.0**-126
    )


def is_never_zero(value: ir.Value | None) -> bool:
    """Return whether no element of a graph value can be zero, or be flushed to zero by a GPU.

    NaN counts as not zero: other rules report it.
    """
    known = constant_of(value)
    if value is None:
        return False
    if known is not None:
        return bool((np.abs(known) >= smallest_normal(value.dtype)).all())
    return lower_bound(value) >= smallest_normal(value.dtype) or _replaces_zero(value)


def lower_bound(value: ir.Value | None, depth: int = 0) -> float:
    """Return a lower bound of the elements of a graph value; −∞ if no bound is known."""
    known = constant_of(value)
    if known is not None:
        return float(known.min()) if known.size and not np.isnan(known).any() else -math.inf
    node = value.producer() if value is not None else None
    if node is None or depth > _MAX_DEPTH:
        return -math.inf

    def input_bound(index: int) -> float:
        argument = node.inputs[index] if index < len(node.inputs) else None
        return -math.inf if argument is None else lower_bound(argument, depth + 1)

    if is_op(node, *_BOUND_KEEPING_OPERATORS):
        return input_bound(0)
    if is_op(node, *_NONNEGATIVE_OPERATORS) or _is_square_node(node):
        return 0.0
    if is_op(node, "Relu"):
        return max(0.0, input_bound(0))
    if is_op(node, "Clip"):
        return max(input_bound(0), input_bound(1))
    if is_op(node, "Max"):
        return max(input_bound(index) for index in range(len(node.inputs)))
    if is_op(node, "Min", "Concat"):
        return min(input_bound(index) for index in range(len(node.inputs)))
    if is_op(node, "Where"):
        return min(input_bound(1), input_bound(2))
    if is_op(node, "Add"):
        return input_bound(0) + input_bound(1)
    if is_op(node, "Mul"):
        if input_bound(0) >= 0 and input_bound(1) >= 0:
            return input_bound(0) * input_bound(1)
        return -math.inf
    if is_op(node, "Sqrt"):
        return math.sqrt(max(0.0, input_bound(0)))
    if is_op(node, "ReduceSum"):
        return input_bound(0) if input_bound(0) >= 0 else -math.inf
    return -math.inf


def _is_square_node(node: ir.Node) -> bool:
    """Return whether a node computes squares: x · x, or x to an even power."""
    if is_op(node, "Mul"):
        return node.inputs[0] is node.inputs[1]
    exponent = constant_of(node.inputs[1]) if is_op(node, "Pow") else None
    return exponent is not None and bool((exponent % 2 == 0).all() and (exponent > 0).all())


def _replaces_zero(value: ir.Value) -> bool:
    """Return whether a graph value is Where(v = 0, c, v) or Where(v > 0, v, c) with c ≠ 0."""
    node = value.producer()
    test = node.inputs[0].producer() if is_op(node, "Where") and node.inputs[0] else None  # type: ignore[union-attr]
    if node is None or test is None or not is_op(test, "Equal", "Greater"):
        return False
    zero, value_if_true, value_if_false = constant_of(test.inputs[1]), *node.inputs[1:3]
    if zero is None:
        return False
    if is_op(test, "Equal"):
        return not zero.any() and value_if_false is test.inputs[0] and is_never_zero(value_if_true)
    is_not_negative = bool((zero >= 0).all())
    return is_not_negative and value_if_true is test.inputs[0] and is_never_zero(value_if_false)
