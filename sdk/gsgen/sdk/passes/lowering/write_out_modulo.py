"""Rewrites Mod by division and multiplication, because no runtime has a kernel for Mod."""

__all__ = ["WriteOutModulo"]


import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.onnx_facts import FLOAT_TYPES
from gsgen.sdk.passes.framework.base import ErrorBudget, SubstituteNodes
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import int_attribute, numpy_dtype

_INTEGER_TYPES = (ir.DataType.INT32, ir.DataType.INT64)


class WriteOutModulo(SubstituteNodes):
    """Replace Mod by a division: no runtime release has a kernel for Mod.

    Integers are exact. The float remainder has the sign of x; if rounding makes the quotient one
    too large or too small, the remainder is corrected by one y::

        1  Mod(i, j)         →   r + Where(r ≠ 0 and sign(r) ≠ sign(j), j, 0), where r = i − (i / j) · j
        2  Mod<fmod>(x, y)   →   x − Trunc(x / y) · y

    Case 2 holds for quotients below 2²⁴ (2¹¹ in float16); for larger ones, and for an infinite
    divisor, the float remainder is wrong.
    """

    name = "write-out-modulo"
    exactness = ErrorBudget(relative=1e-5)
    kinds = frozenset({"Mod"})

    def can_replace(self, node: ir.Node) -> bool:
        """Return whether Mod computes signed integers, or floats with the dividend's sign."""
        value = node.inputs[0]
        kind = None if value is None else value.dtype
        return kind in _INTEGER_TYPES or (
            kind in FLOAT_TYPES and bool(int_attribute(node, "fmod", 0))
        )

    def replace(self, node: ir.Node) -> None:
        """Replace Mod: subtract the divisor's largest multiple from the dividend."""
        write = InsertionPoint(node)
        x, y = node.inputs
        assert x is not None
        assert y is not None
        zero = write.constant(np.zeros((), numpy_dtype(x)))
        if x.dtype in _INTEGER_TYPES:  # Case 1
            write.replace(_integer_remainder(write, x, y, zero, int_attribute(node, "fmod", 0)))
            return
        write.replace(_float_remainder(write, x, y, zero))  # Case 2


def _integer_remainder(
    write: InsertionPoint, x: ir.Value, y: ir.Value, zero: ir.Value, has_dividend_sign: int
) -> ir.Value:
    """Return the remainder of integers, with the sign of the divisor or of the dividend."""
    remainder = write.op("Sub", x, write.op("Mul", write.op("Div", x, y), y))
    if has_dividend_sign:
        return remainder
    # The remainder is nonzero and its sign differs from that of y exactly if their product is
    # negative. The product might overflow, so the remainder is multiplied by the sign of y only.
    sign_product = write.op(
        "Where",
        _write_absolute_value(write, y, zero),
        remainder,
        write.op("Sub", zero, remainder),
        dtype=x.dtype,
    )
    has_wrong_sign = write.op("Less", sign_product, zero, dtype=ir.DataType.BOOL)
    return write.op("Add", remainder, write.op("Where", has_wrong_sign, y, zero, dtype=x.dtype))


def _float_remainder(write: InsertionPoint, x: ir.Value, y: ir.Value, zero: ir.Value) -> ir.Value:
    """Return the remainder of a float division, with the sign of the dividend."""
    size, step = write.op("Abs", x), write.op("Abs", y)
    count = write.op("Floor", write.op("Div", size, step))
    remainder = write.op("Sub", size, write.op("Mul", count, step))
    is_remainder_too_small = write.op("Less", remainder, step, dtype=ir.DataType.BOOL)
    remainder = write.op(
        "Where", is_remainder_too_small, remainder, write.op("Sub", remainder, step), dtype=x.dtype
    )
    is_negative = write.op("Less", remainder, zero, dtype=ir.DataType.BOOL)
    remainder = write.op(
        "Where", is_negative, write.op("Add", remainder, step), remainder, dtype=x.dtype
    )
    return write.op(
        "Where",
        _write_absolute_value(write, x, zero),
        remainder,
        write.op("Neg", remainder),
        dtype=x.dtype,
    )


def _write_absolute_value(write: InsertionPoint, x: ir.Value, zero: ir.Value) -> ir.Value:
    return write.op("Greater", x, zero, dtype=ir.DataType.BOOL)
