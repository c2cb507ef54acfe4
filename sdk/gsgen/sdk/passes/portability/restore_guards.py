"""Restores the guards, removed by exporters, against division by a vector's zero length."""

__all__ = ["RestoreGuards"]


import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.onnx_facts import FLOAT_TYPES
from gsgen.sdk.passes.framework.base import ErrorBudget, every_node, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.lower_bounds import is_never_zero, smallest_normal
from gsgen.sdk.passes.framework.value_facts import constant_of, required

_MOVE_OPERATORS = (
    *("Cast", "Expand", "Flatten", "Gather", "Identity", "Reshape", "Slice", "Squeeze"),
    *("Transpose", "Unsqueeze"),
)
# The numbers that replace a length of zero, and its square.
_MIN_LENGTH, _MIN_SQUARED_LENGTH = 1e-12, 1e-24


class RestoreGuards(SkippableRewrite):
    """Guard divisions by a vector's length that may be zero.

    The exporter drops ``x + c`` for c up to 1e-8, and a guard of 1e-12 is zero in float16: a zero
    vector, as in a rest pose or for a camera at a point's position, becomes NaN. If the divisor is
    a length or its square and may be zero, a small number replaces zero, and only zero::

        v / Sqrt(ReduceSum(v · v))   →   v / Where(length = 0, 1e-12, length)

    So 0 / 0 becomes 0, and finite values keep every bit. A length is the root of a sum of squares,
    or ReduceL2; guards that are too small for their dtype are ignored. Any other divisor that may
    be zero stays as it is and is reported: only the author knows the result of a division by a
    depth of zero.
    """

    name = "restore-guards"
    exactness = ErrorBudget(repairs_nonfinite=True)

    def rewrite(self, model: ir.Model) -> None:
        """Replace zeros by a tiny number in vector lengths that are divisors and may be zero."""
        for node in list(every_node(model)):
            divisor_index = _divisor_index(node)
            if divisor_index is None:
                continue
            divisor = required(node.inputs[divisor_index])
            if divisor.dtype not in FLOAT_TYPES or is_never_zero(divisor):
                continue
            if constant_of(divisor) is not None or not (
                _is_vector_length(divisor) or _is_squared_length(divisor)
            ):
                self.refuse(node, f"its divisor {divisor.name} may be zero, and is not a length")
                continue
            self.note(node)
            _insert_guard(node, divisor_index)


def _divisor_index(node: ir.Node) -> int | None:
    """Return the index of the input that a node divides by; None if the node does not divide."""
    if is_op(node, "Div"):
        return 1
    if is_op(node, "Reciprocal"):
        return 0
    exponent = constant_of(node.inputs[1]) if is_op(node, "Pow") else None
    return 0 if exponent is not None and (exponent < 0).any() else None


def _insert_guard(node: ir.Node, divisor_index: int) -> None:
    divisor = required(node.inputs[divisor_index])
    assert divisor.dtype is not None
    minimum = _MIN_LENGTH if _is_vector_length(divisor) else _MIN_SQUARED_LENGTH
    smallest, dtype = max(minimum, smallest_normal(divisor.dtype)), divisor.dtype.numpy()
    before = InsertionPoint(node)
    zero, smallest_value = (before.constant(np.asarray(value, dtype)) for value in (0, smallest))
    is_zero = before.op("Equal", divisor, zero, dtype=ir.DataType.BOOL, shape=divisor.shape)
    guarded_divisor = before.op(
        "Where", is_zero, smallest_value, divisor, dtype=divisor.dtype, shape=divisor.shape
    )
    node.replace_input_with(divisor_index, guarded_divisor)


def _is_vector_length(value: ir.Value | None) -> bool:
    source_node = _producer_behind_guards(value)
    if is_op(source_node, "ReduceL2"):
        return True
    if source_node is None or not is_op(source_node, "Sqrt", "Pow"):
        return False
    exponent = constant_of(source_node.inputs[1]) if is_op(source_node, "Pow") else np.array(0.5)
    return (
        exponent is not None
        and bool((exponent == 0.5).all())
        and _is_squared_length(source_node.inputs[0])
    )


def _is_squared_length(value: ir.Value | None) -> bool:
    """Return whether a graph value is a sum or mean of squares, i.e. a squared length."""
    source_node = _producer_behind_guards(value)
    if source_node is None:
        return False
    if is_op(source_node, "ReduceSumSquare") or _is_one_square(source_node):
        return True
    if is_op(source_node, "ReduceSum", "ReduceMean"):
        return _is_squared_length(source_node.inputs[0])
    if is_op(source_node, "Add"):
        return _is_squared_length(source_node.inputs[0]) and _is_squared_length(
            source_node.inputs[1]
        )
    return False


def _is_one_square(node: ir.Node) -> bool:
    if is_op(node, "Mul"):
        return node.inputs[0] is node.inputs[1]
    exponent = constant_of(node.inputs[1]) if is_op(node, "Pow") else None
    return exponent is not None and bool((exponent == 2).all())


def _producer_behind_guards(value: ir.Value | None) -> ir.Node | None:
    """Return the node that computes a value, before reshapes and guards with a too small ε."""
    while value is not None:
        source_node = value.producer()
        if source_node is None:
            return None
        input_index = (
            0 if is_op(source_node, *_MOVE_OPERATORS) else _guarded_input_index(source_node)
        )
        if input_index is None:
            return source_node
        value = source_node.inputs[input_index]
    return None


def _guarded_input_index(node: ir.Node) -> int | None:
    """Return the index of x in a zero guard such as Max(x, ε) whose ε is too small; else None."""
    if not is_op(node, "Add", "Clip", "Max") or len(node.inputs) < 2:
        return None
    for input_index in (0, 1):
        floor_constant = constant_of(node.inputs[1 - input_index])
        if floor_constant is None or (is_op(node, "Clip") and input_index):
            continue
        smallest = smallest_normal(node.outputs[0].dtype)
        return input_index if ((floor_constant >= 0) & (floor_constant < smallest)).all() else None
    return None
