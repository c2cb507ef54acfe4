"""Signs, and the questions whether a number is none or has no end, by comparisons."""

__all__ = ["WriteOutSigns"]

from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import Substitute
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import int_attribute


class WriteOutSigns(Substitute):
    """Write Sign, IsNaN and IsInf with comparisons, and signs of integers with a difference.

    No release has kernels for the first three, nor for Abs, Neg and Relu of int32::

        Sign(x)    →   Where(x > 0, 1, Where(x < 0, −1, x))
        IsNaN(x)   →   Not(x = x)
        Neg(i)     →   0 − i

    A WGSL compiler may assume that there are no NaNs; where a model relies on IsNaN, compare its
    replays at level ``live``.
    """

    name: ClassVar[str] = "write-out-signs"
    kinds: ClassVar[frozenset[str]] = frozenset(
        {"Abs", "IsInf", "IsNaN", "Neg", "Relu", "Sign"}
    )

    def suits(self, node: ir.Node) -> bool:
        """Say whether the dtype is one that can be compared and is not simpler as it is."""
        value = node.inputs[0]
        if value is None or value.dtype is None:
            return False
        if node.op_type in ("Abs", "Neg", "Relu"):
            return value.dtype in (ir.DataType.INT32, ir.DataType.INT64)
        return True

    def replace(self, node: ir.Node) -> None:
        """Write it with comparisons."""
        write, x = InsertionPoint(node), node.inputs[0]
        assert x is not None
        assert x.dtype is not None
        kind = x.dtype.numpy()

        def number(value: float) -> ir.Value:
            return write.constant(np.asarray(value, kind), "number")

        def test(how: str, a: ir.Value, b: ir.Value) -> ir.Value:
            return write.op(how, a, b, dtype=ir.DataType.BOOL)

        def where(condition: ir.Value, then: ir.Value, other: ir.Value) -> ir.Value:
            return write.op("Where", condition, then, other, dtype=x.dtype)

        zero = number(0)
        match node.op_type:
            case "Neg":
                made = write.op("Sub", zero, x)
            case "Abs":
                made = where(test("Less", x, zero), write.op("Sub", zero, x), x)
            case "Relu":
                made = where(test("Less", x, zero), zero, x)
            case "IsNaN":
                made = write.op("Not", test("Equal", x, x))
            case "IsInf":
                made = _endless(write, node, x)
            case _:
                # What is neither above nor below zero is zero, or NaN, and stays so.
                below = where(test("Less", x, zero), _minus_one(write, kind, zero), x)
                made = where(test("Greater", x, zero), number(1), below)
        write.replace(made)


def _minus_one(write: InsertionPoint, kind: np.dtype, zero: ir.Value) -> ir.Value:
    """Return −1; unsigned integers hold none, and never ask for it."""
    return zero if kind.kind == "u" else write.constant(np.asarray(-1, kind), "number")


def _endless(write: InsertionPoint, node: ir.Node, x: ir.Value) -> ir.Value:
    """Write IsInf: of either sign, or of the one that is asked for."""
    assert x.dtype is not None
    kind = x.dtype.numpy()
    end = write.constant(np.asarray(np.inf, kind), "number")
    up, down = (
        int_attribute(node, f"detect_{sign}", 1) for sign in ("positive", "negative")
    )
    if up and down:
        x = write.op("Abs", x)
    elif down:
        x = write.op("Neg", x)
    elif not up:  # neither is asked for
        end = write.constant(np.asarray(np.nan, kind), "number")
    return write.op("Equal", x, end, dtype=ir.DataType.BOOL)
