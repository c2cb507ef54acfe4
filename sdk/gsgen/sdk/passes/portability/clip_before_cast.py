"""Moves a Clip before a Cast to integers, so that Clip runs on floats."""

__all__ = ["ClipBeforeCast"]


import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, required

_INTEGER_TYPES = (ir.DataType.INT32, ir.DataType.INT64)
# Up to this number, a dtype represents every integer.
_EXACT_INTEGERS = {ir.DataType.FLOAT: 2**24, ir.DataType.FLOAT16: 2**11, ir.DataType.DOUBLE: 2**53}


class ClipBeforeCast(NodeRewrite):
    """Clip floats before they are cast to integers, instead of the integers after the cast.

    A frame number is ``(t * frames).long().clamp(0, frames - 1)``: an int64 Clip, which hardly any
    release has a kernel for, of a number with an unknown range. Integer bounds commute with the
    truncation, and a clipped number fits an int32::

        Clip(Cast<to int64>(x), 0, 59)   →   Cast<to int64>(Clip(x, 0, 59))

    Numbers outside of int64 are an exception, because ONNX does not define their cast. Numbers that
    are too large now become the upper bound; NaN stays undefined.
    """

    name = "clip-before-cast"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node clips floats that were cast to integers, with constant bounds."""
        if not is_op(node, "Clip", "Max", "Min") or self.opset < 12 or node.inputs[0] is None:
            return False
        source_node = node.inputs[0].producer()
        x = (
            source_node.inputs[0]
            if source_node is not None and is_op(source_node, "Cast")
            else None
        )
        if (
            x is None
            or x.dtype not in _EXACT_INTEGERS
            or node.inputs[0].dtype not in _INTEGER_TYPES
        ):
            return False
        bounds = _bounds(node)
        return bounds is not None and all(
            bound is None or abs(bound) <= _EXACT_INTEGERS[x.dtype] for bound in bounds
        )

    def replace(self, node: ir.Node) -> None:
        """Clip the float input of a Cast to integers, and cast the result."""
        source_node = required(node.inputs[0].producer() if node.inputs[0] is not None else None)
        x = required(source_node.inputs[0])
        kind = required(node.outputs[0].dtype)
        bounds = required(_bounds(node))
        assert x.dtype is not None
        write, dtype = InsertionPoint(node), x.dtype.numpy()
        numbers = [
            None if bound is None else write.constant(np.asarray(bound, dtype), "bound")
            for bound in bounds
        ]
        while numbers and numbers[-1] is None:
            numbers.pop()
        clipped_value = write.op("Clip", x, *numbers, shape=x.shape)
        write.replace(write.op("Cast", clipped_value, dtype=kind, shape=x.shape, to=int(kind)))


def _bounds(node: ir.Node) -> tuple[int | None, int | None] | None:
    """Return the lower and upper bound of a Clip; None if a bound is not a single constant."""
    arguments = (*node.inputs[1:], None, None)[:2]
    numbers: list[int | None] = []
    for value in arguments:
        known = constant_of(value)
        if value is not None and (known is None or known.size != 1 or known.ndim > 0):
            return None
        numbers.append(None if known is None else int(known))
    low, high = numbers
    if is_op(node, "Clip"):
        return (low, high) if low is not None or high is not None else None
    if len(node.inputs) != 2:
        return None
    return (low, None) if is_op(node, "Max") else (None, low)
