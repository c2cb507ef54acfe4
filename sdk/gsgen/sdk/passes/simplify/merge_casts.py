"""Merges consecutive Cast operators."""

__all__ = ["MergeCasts", "can_hold_all_values"]


import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import required

_INTEGERS_OF_64_BITS = (ir.DataType.INT64, ir.DataType.UINT64)


class MergeCasts(NodeRewrite):
    """Merge a Cast with a preceding Cast that loses no information.

    Exporters and other passes cast masks and indices back and forth::

        Cast<to int32>(Cast<to int64>(x: int32))   →   x
        Cast<to float>(Cast<to int64>(x: bool))    →   Cast<to float>(x)
    """

    name = "merge-casts"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node casts the output of a Cast that loses no information."""
        value = node.inputs[0] if is_op(node, "Cast") else None
        inner_cast = value.producer() if value is not None else None
        if (
            value is None
            or inner_cast is None
            or not is_op(inner_cast, "Cast")
            or not inner_cast.inputs[0]
        ):
            return False
        first_dtype, middle_dtype = inner_cast.inputs[0].dtype, value.dtype
        last_dtype = node.outputs[0].dtype
        if (
            first_dtype is None
            or middle_dtype is None
            or last_dtype is None
            or not can_hold_all_values(middle_dtype, first_dtype)
        ):
            return False
        # The cast of a number that does not fit differs between dtypes.
        does_truncate = (
            middle_dtype.is_integer() and last_dtype.is_integer()
        )  # alike in one step or two
        return (
            can_hold_all_values(last_dtype, first_dtype)
            or first_dtype == ir.DataType.BOOL
            or does_truncate
        )

    def replace(self, node: ir.Node) -> None:
        """Cast the input of two consecutive Casts directly to the last dtype."""
        inner_cast = required(node.inputs[0].producer() if node.inputs[0] is not None else None)
        write = InsertionPoint(node)
        x = required(inner_cast.inputs[0])
        kind = required(node.outputs[0].dtype)
        if x.dtype == kind:
            write.replace(x)
            return
        write.replace(write.op("Cast", x, dtype=kind, shape=x.shape, to=int(kind)))


def can_hold_all_values(container: ir.DataType, contained_type: ir.DataType) -> bool:
    """Return whether one dtype can represent every number of another dtype."""
    if contained_type in _INTEGERS_OF_64_BITS and container.is_floating_point():
        return False  # NumPy calls that safe, although a double holds 53 bits
    try:
        return bool(np.can_cast(contained_type.numpy(), container.numpy(), casting="safe"))
    except TypeError:  # strings, and dtypes of four bits
        return False
