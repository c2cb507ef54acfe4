"""Rewrites Sign, IsNaN, IsInf and integer Abs, Neg and Relu with comparisons."""

__all__ = ["WriteOutSigns"]


import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import SubstituteNodes
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import int_attribute, required


class WriteOutSigns(SubstituteNodes):
    """Replace Sign, IsNaN, IsInf, and integer Abs, Neg and Relu by comparisons and subtractions.

    No release has kernels for the first three, nor for Abs, Neg and Relu of int32::

        Sign(x)    →   Where(x > 0, 1, Where(x < 0, −1, x))
        IsNaN(x)   →   Not(x = x)
        Neg(i)     →   0 − i

    A WGSL compiler may assume that there are no NaNs. If a model relies on IsNaN, compare its
    replays at level ``live``.
    """

    name = "write-out-signs"
    kinds = frozenset({"Abs", "IsInf", "IsNaN", "Neg", "Relu", "Sign"})

    def can_replace(self, node: ir.Node) -> bool:
        """Return whether a node's dtype is known; Abs, Neg and Relu must have int32 or int64."""
        value = node.inputs[0]
        if value is None or value.dtype is None:
            return False
        if node.op_type in ("Abs", "Neg", "Relu"):
            return value.dtype in (ir.DataType.INT32, ir.DataType.INT64)
        return True

    def replace(self, node: ir.Node) -> None:
        """Replace Sign, IsNaN, IsInf, Abs, Neg or Relu by comparisons."""
        write, x = InsertionPoint(node), required(node.inputs[0])
        assert x.dtype is not None
        kind = x.dtype.numpy()

        def number(value: float) -> ir.Value:
            return write.constant(np.asarray(value, kind), "number")

        def compare(comparison: str, a: ir.Value, b: ir.Value) -> ir.Value:
            return write.op(comparison, a, b, dtype=ir.DataType.BOOL)

        def where(
            condition: ir.Value, value_if_true: ir.Value, value_if_false: ir.Value
        ) -> ir.Value:
            return write.op("Where", condition, value_if_true, value_if_false, dtype=x.dtype)

        zero = number(0)
        match node.op_type:
            case "Neg":
                result = write.op("Sub", zero, x)
            case "Abs":
                result = where(compare("Less", x, zero), write.op("Sub", zero, x), x)
            case "Relu":
                result = where(compare("Less", x, zero), zero, x)
            case "IsNaN":
                result = write.op("Not", compare("Equal", x, x))
            case "IsInf":
                result = _is_infinite(write, node, x)
            case _:
                # Numbers neither above nor below zero are zero or NaN, and stay so.
                negative_sign = where(
                    compare("Less", x, zero), _minus_one_constant(write, kind, zero), x
                )
                result = where(compare("Greater", x, zero), number(1), negative_sign)
        write.replace(result)


def _minus_one_constant(write: InsertionPoint, kind: np.dtype, zero: ir.Value) -> ir.Value:
    """Return the constant −1 in a value's dtype, or zero if the dtype is unsigned."""
    return zero if kind.kind == "u" else write.constant(np.asarray(-1, kind), "number")


def _is_infinite(write: InsertionPoint, node: ir.Node, x: ir.Value) -> ir.Value:
    """Replace IsInf for both signs, or for the sign that its attributes select."""
    assert x.dtype is not None
    kind = x.dtype.numpy()
    end = write.constant(np.asarray(np.inf, kind), "number")
    positive_detector, negative_detector = (
        int_attribute(node, f"detect_{sign}", 1) for sign in ("positive", "negative")
    )
    if positive_detector and negative_detector:
        x = write.op("Abs", x)
    elif negative_detector:
        x = write.op("Neg", x)
    elif not positive_detector:  # no sign is selected, so no number may compare as equal
        end = write.constant(np.asarray(np.nan, kind), "number")
    return write.op("Equal", x, end, dtype=ir.DataType.BOOL)
