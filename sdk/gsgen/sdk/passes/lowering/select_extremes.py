"""Rewrites Max, Min and Clip with comparisons, for runtimes without their kernels."""

__all__ = ["SelectExtremes"]


import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, SubstituteNodes, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, rank_of, required

_CLIP_TYPES = (ir.DataType.FLOAT, ir.DataType.FLOAT16)


class SelectExtremes(SubstituteNodes):
    """Replace Max, Min and Clip by comparisons if a runtime release has no kernel for them.

    onnxruntime-web 1.22 has no kernel for Max and Min in any dtype, nor for Clip in int32. A single
    constant bound becomes a Clip of floats; all other operands are compared and selected::

        1  Max(x, 0.1)       →   Clip(x, min = 0.1)
        2  Max(a, b)         →   Where(a < b, b, a), and b if b is NaN, as in Max
        3  Clip(i, lo, hi)   →   Where(i < lo, lo, i), and likewise for hi

    In case 1, infinity may become the largest finite number: the default of the other bound.
    """

    name = "select-extremes"
    exactness = ErrorBudget(repairs_nonfinite=True)
    kinds = frozenset({"Clip", "Max", "Min"})

    def can_replace(self, node: ir.Node) -> bool:
        """Return whether a node's dtype is known and, for Clip, whether a bound is set."""
        value = node.inputs[0] if node.inputs else None
        if value is None or value.dtype is None:
            return False
        return not is_op(node, "Clip") or (self.opset >= 11 and len(node.inputs) > 1)

    def replace(self, node: ir.Node) -> None:
        """Replace Max, Min or Clip by pairwise comparisons of its arguments."""
        write, first = InsertionPoint(node), required(node.inputs[0])
        if is_op(node, "Clip"):  # Case 3
            low, high = (*node.inputs[1:], None)[:2]
            result = first if low is None else _replace_beyond_bound(write, "Less", first, low)
            result = (
                result if high is None else _replace_beyond_bound(write, "Greater", result, high)
            )
        else:
            result = first
            for argument in node.inputs[1:]:
                assert argument is not None
                result = _write_elementwise_extreme(write, node.op_type, result, argument)
        if result is first:
            result = write.op("Identity", first)
        write.replace(result)


def _write_elementwise_extreme(
    write: InsertionPoint, kind: str, a: ir.Value, b: ir.Value
) -> ir.Value:
    """Return the larger or smaller of two values; NaN if one of them is NaN."""
    for x, bound_value in ((a, b), (b, a)):
        bound = _finite_number(bound_value)
        scalar = bound is not None and (rank_of(bound_value) or 0) <= (rank_of(x) or 0)
        if x.dtype in _CLIP_TYPES and scalar and rank_of(x) is not None:
            # Case 1: a single constant bound
            number = write.constant(np.asarray(bound).reshape(()), "bound")
            return write.op("Clip", x, *((number,) if kind == "Max" else (None, number)))
    # Case 2: compare and select
    extreme_value = _replace_beyond_bound(write, "Less" if kind == "Max" else "Greater", a, b)
    if not (b.dtype is not None and b.dtype.is_floating_point()) or _is_finite(b):
        return extreme_value
    not_nan_mask = write.op("Equal", b, b, dtype=ir.DataType.BOOL)
    return write.op("Where", not_nan_mask, extreme_value, b, dtype=b.dtype)


def _replace_beyond_bound(
    write: InsertionPoint, test: str, x: ir.Value, bound: ir.Value
) -> ir.Value:
    """Clamp a graph value at a bound, by replacing the elements beyond the bound."""
    is_beyond_bound = write.op(test, x, bound, dtype=ir.DataType.BOOL)
    return write.op("Where", is_beyond_bound, bound, x, dtype=x.dtype)


def _finite_number(value: ir.Value) -> np.ndarray | None:
    array = constant_of(value)
    return array if array is not None and array.size == 1 and np.isfinite(array).all() else None


def _is_finite(value: ir.Value) -> bool:
    array = constant_of(value)
    return array is not None and bool(np.isfinite(array).all())
