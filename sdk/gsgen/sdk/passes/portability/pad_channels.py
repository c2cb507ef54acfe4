"""Pads the input channels of convolutions that WebGPU computes wrongly."""

__all__ = ["PadChannels"]

from math import prod

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, NodeRewrite, TableRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute, required

_VECTOR_WIDTH = 4
# A kernel reads three channels at once where four are too many; it is right for exactly three.
_NARROW_VECTOR_WIDTH = 3
_MAX_SPATIAL_AXES = 2


class PadChannels(TableRewrite, NodeRewrite):
    """Add channels of zeros to the input of a Conv until their number is a multiple of four.

    ONNX Runtime's WebGPU kernel computes a Conv of one or two spatial axes wrongly, without any
    error (observed in 1.31; issue 29651 of microsoft/onnxruntime), if its input has 6, 9, 15, 18,
    21 … channels, which are a multiple of three but not of four, and its output a multiple of four.
    Such are pictures with normals, or with the rays of their pixels. Weights of zero for channels
    of zero change nothing::

        Conv(x, w)   →   Conv(Pad(x), zero-padded w)

    Kernels of one pixel, groups and three channels are computed rightly, and stay as they are.
    """

    name = "pad-channels"
    exactness = ErrorBudget(relative=1e-6)
    wanted_by = "targets of WebGPU"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node is a Conv with constant weights that is computed wrongly."""
        if not is_op(node, "Conv") or int_attribute(node, "group", 1) != 1:
            return False
        shape = fixed_shape(node.inputs[1])
        if shape is None or not 1 <= len(shape) - 2 <= _MAX_SPATIAL_AXES:
            return False
        count, channels = shape[:2]
        is_read_in_threes = channels % _NARROW_VECTOR_WIDTH == 0 and channels % _VECTOR_WIDTH
        return (
            bool(is_read_in_threes)
            and channels > _NARROW_VECTOR_WIDTH
            and count % _VECTOR_WIDTH == 0
            and prod(shape[2:]) > 1
            and constant_of(node.inputs[1], prod(shape)) is not None
        )

    def replace(self, node: ir.Node) -> None:
        """Pad the input and the weights of a Conv with channels of zeros."""
        write, x = InsertionPoint(node), required(node.inputs[0])
        shape = required(fixed_shape(node.inputs[1]))
        weights = required(constant_of(node.inputs[1], prod(shape)))
        missing, rank = -shape[1] % _VECTOR_WIDTH, len(shape)
        padded_weights = np.pad(weights, [(0, 0), (0, missing), *[(0, 0)] * (rank - 2)])
        ends = [missing if axis == 1 else 0 for axis in range(rank)]
        padded = write.op("Pad", x, write.int64(*[0] * rank, *ends), mode="constant")
        node.replace_input_with(0, padded)
        node.replace_input_with(1, write.constant(padded_weights, "weights"))
