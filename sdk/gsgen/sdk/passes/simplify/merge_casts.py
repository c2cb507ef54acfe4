"""Casts of casts."""

__all__ = ["MergeCasts", "holds_all"]

from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint

_WIDEST = (ir.DataType.INT64, ir.DataType.UINT64)


class MergeCasts(NodeRewrite):
    """Cast once where a Cast follows a Cast that lost nothing.

    Masks and indices are cast to and fro by exporters, and by other passes::

        Cast<to int32>(Cast<to int64>(x: int32))   →   x
        Cast<to float>(Cast<to int64>(x: bool))    →   Cast<to float>(x)
    """

    name: ClassVar[str] = "merge-casts"

    def matches(self, node: ir.Node) -> bool:
        """Say whether ``node`` casts what was cast without loss."""
        value = node.inputs[0] if is_op(node, "Cast") else None
        inner = value.producer() if value is not None else None
        if (
            value is None
            or inner is None
            or not is_op(inner, "Cast")
            or not inner.inputs[0]
        ):
            return False
        first, between = inner.inputs[0].dtype, value.dtype
        last = node.outputs[0].dtype
        if (
            first is None
            or between is None
            or last is None
            or not holds_all(between, first)
        ):
            return False
        # A number that does not fit is cast in ways that differ between dtypes.
        return (
            holds_all(last, first)
            or first == ir.DataType.BOOL
            or _both_whole(between, last)
        )

    def replace(self, node: ir.Node) -> None:
        """Cast what the first Cast took."""
        inner = node.inputs[0].producer() if node.inputs[0] is not None else None
        assert inner is not None
        write, x, kind = InsertionPoint(node), inner.inputs[0], node.outputs[0].dtype
        assert kind is not None
        assert x is not None
        if x.dtype == kind:
            write.replace(x)
            return
        write.replace(write.op("Cast", x, dtype=kind, shape=x.shape, to=int(kind)))


def holds_all(wide: ir.DataType, narrow: ir.DataType) -> bool:
    """Say whether every number of ``narrow`` is one of ``wide``."""
    if narrow in _WIDEST and wide.is_floating_point():
        return False  # NumPy calls that safe, although a double holds 53 bits
    try:
        return bool(np.can_cast(narrow.numpy(), wide.numpy(), casting="safe"))
    except TypeError:  # strings, and dtypes of four bits
        return False


def _both_whole(between: ir.DataType, last: ir.DataType) -> bool:
    """Say whether casting by way of ``between`` cuts the same bits off as casting at once."""
    return between.is_integer() and last.is_integer()
