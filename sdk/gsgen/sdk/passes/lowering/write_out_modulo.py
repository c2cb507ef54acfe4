"""Remainders, by dividing and multiplying."""

__all__ = ["WriteOutModulo"]

from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, Substitute
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import int_attribute

_INTEGERS = (ir.DataType.INT32, ir.DataType.INT64)
_FLOATS = (ir.DataType.FLOAT, ir.DataType.FLOAT16, ir.DataType.DOUBLE)


class WriteOutModulo(Substitute):
    """Write Mod with a division, of which no release has a kernel for Mod.

    Integers are exact. A remainder of floats is what is left of x after as many y as fit, with the
    sign of x; where rounding puts one y too many or too few, it is mended by one::

        Mod(i, j)           →   r + Where(r ≠ 0 and sign(r) ≠ sign(j), j, 0), where r = i − (i / j) · j
        Mod<fmod>(x, y)     →   x − Trunc(x / y) · y

    That holds for quotients below 2²⁴ (2¹¹ in float16); beyond, and for a divisor without end, the
    float remainder is not right.
    """

    name: ClassVar[str] = "write-out-modulo"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=1e-5)
    kinds: ClassVar[frozenset[str]] = frozenset({"Mod"})

    def suits(self, node: ir.Node) -> bool:
        """Say whether it is of signed integers, or of floats with the sign of the dividend."""
        value = node.inputs[0]
        kind = None if value is None else value.dtype
        return kind in _INTEGERS or (
            kind in _FLOATS and bool(int_attribute(node, "fmod", 0))
        )

    def replace(self, node: ir.Node) -> None:
        """Divide, and take the multiple away."""
        write = InsertionPoint(node)
        x, y = node.inputs
        assert x is not None
        assert y is not None
        assert x.dtype is not None
        zero = write.constant(np.zeros((), x.dtype.numpy()))
        if x.dtype in _INTEGERS:
            write.replace(_of_integers(write, x, y, zero, int_attribute(node, "fmod", 0)))
            return
        write.replace(_of_floats(write, x, y, zero))


def _of_integers(
    write: InsertionPoint, x: ir.Value, y: ir.Value, zero: ir.Value, of_dividend: int
) -> ir.Value:
    """Return the remainder with the sign of ``y``, or with that of ``x``."""
    rest = write.op("Sub", x, write.op("Mul", write.op("Div", x, y), y))
    if of_dividend:
        return rest
    # They differ in sign, and the remainder is not zero, exactly if their product is negative;
    # the product itself might overflow, so signs are taken first.
    other = write.op(
        "Where", _positive(write, y, zero), rest, write.op("Sub", zero, rest), dtype=x.dtype
    )
    wrong = write.op("Less", other, zero, dtype=ir.DataType.BOOL)
    return write.op("Add", rest, write.op("Where", wrong, y, zero, dtype=x.dtype))


def _of_floats(write: InsertionPoint, x: ir.Value, y: ir.Value, zero: ir.Value) -> ir.Value:
    """Work with sizes alone, and give the sign of ``x`` back at the end."""
    size, step = write.op("Abs", x), write.op("Abs", y)
    count = write.op("Floor", write.op("Div", size, step))
    rest = write.op("Sub", size, write.op("Mul", count, step))
    few = write.op("Less", rest, step, dtype=ir.DataType.BOOL)
    rest = write.op("Where", few, rest, write.op("Sub", rest, step), dtype=x.dtype)
    many = write.op("Less", rest, zero, dtype=ir.DataType.BOOL)
    rest = write.op("Where", many, write.op("Add", rest, step), rest, dtype=x.dtype)
    return write.op(
        "Where", _positive(write, x, zero), rest, write.op("Neg", rest), dtype=x.dtype
    )


def _positive(write: InsertionPoint, x: ir.Value, zero: ir.Value) -> ir.Value:
    return write.op("Greater", x, zero, dtype=ir.DataType.BOOL)
