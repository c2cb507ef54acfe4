"""The larger and the smaller of numbers, without an operator for it."""

__all__ = ["SelectExtremes"]

from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, Substitute, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, rank_of

_FLOATS = (ir.DataType.FLOAT, ir.DataType.FLOAT16)


class SelectExtremes(Substitute):
    """Write Max, Min and Clip with comparisons where a release has no kernel for them.

    onnxruntime-web 1.22 has kernels for Max and Min in no dtype, and for Clip not in int32. A bound
    that is one constant becomes a Clip of floats; anything else is compared and selected::

        Max(x, 0.1)   →   Clip(x, min = 0.1)
        Max(a, b)     →   Where(a < b, b, a), and b where b is NaN, as Max has it

    A Clip with one bound has the largest finite number as the other one, so infinity may become
    that.
    """

    name: ClassVar[str] = "select-extremes"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(repairs_nonfinite=True)
    kinds: ClassVar[frozenset[str]] = frozenset({"Clip", "Max", "Min"})

    def suits(self, node: ir.Node) -> bool:
        """Say whether the dtype is known, and there is something to compare."""
        value = node.inputs[0] if node.inputs else None
        if value is None or value.dtype is None:
            return False
        return not is_op(node, "Clip") or (self.opset >= 11 and len(node.inputs) > 1)

    def replace(self, node: ir.Node) -> None:
        """Compare argument by argument."""
        write, first = InsertionPoint(node), node.inputs[0]
        assert first is not None
        if is_op(node, "Clip"):
            low, high = (*node.inputs[1:], None)[:2]
            made = first if low is None else _selected(write, "Less", first, low)
            made = made if high is None else _selected(write, "Greater", made, high)
        else:
            made = first
            for other in node.inputs[1:]:
                assert other is not None
                made = _extreme(write, node.op_type, made, other)
        if made is first:
            made = write.op("Identity", first)
        write.replace(made)


def _extreme(write: InsertionPoint, kind: str, a: ir.Value, b: ir.Value) -> ir.Value:
    """Return the larger or the smaller of two; NaN where one is NaN."""
    for x, other in ((a, b), (b, a)):
        bound = _one_number(other)
        scalar = bound is not None and (rank_of(other) or 0) <= (rank_of(x) or 0)
        if x.dtype in _FLOATS and scalar and rank_of(x) is not None:
            number = write.constant(np.asarray(bound).reshape(()), "bound")
            return write.op("Clip", x, *((number,) if kind == "Max" else (None, number)))
    chosen = _selected(write, "Less" if kind == "Max" else "Greater", a, b)
    if not (b.dtype is not None and b.dtype.is_floating_point()) or _is_finite(b):
        return chosen
    number_itself = write.op("Equal", b, b, dtype=ir.DataType.BOOL)
    return write.op("Where", number_itself, chosen, b, dtype=b.dtype)


def _selected(write: InsertionPoint, test: str, x: ir.Value, bound: ir.Value) -> ir.Value:
    """Return ``bound`` where ``x`` is beyond it, and else ``x``."""
    beyond = write.op(test, x, bound, dtype=ir.DataType.BOOL)
    return write.op("Where", beyond, bound, x, dtype=x.dtype)


def _one_number(value: ir.Value) -> np.ndarray | None:
    array = constant_of(value)
    return (
        array
        if array is not None and array.size == 1 and np.isfinite(array).all()
        else None
    )


def _is_finite(value: ir.Value) -> bool:
    array = constant_of(value)
    return array is not None and bool(np.isfinite(array).all())
