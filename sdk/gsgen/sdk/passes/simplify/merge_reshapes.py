"""Merges consecutive Reshape, Squeeze, Unsqueeze and Flatten operators."""

__all__ = ["MergeReshapes"]


import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import fixed_shape, required

_RESHAPE_OPERATORS = ("Flatten", "Reshape", "Squeeze", "Unsqueeze")


class MergeReshapes(NodeRewrite):
    """Replace consecutive Reshape, Squeeze, Unsqueeze and Flatten by one Reshape.

    None of them moves an element, so only the last shape counts::

        Squeeze(Unsqueeze(Reshape(x, …), …), …)   →   Reshape(x, last shape)
    """

    name = "merge-reshapes"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node reshapes the output of another reshaping node to a known shape."""
        if not is_op(node, *_RESHAPE_OPERATORS) or node.inputs[0] is None:
            return False
        shape = fixed_shape(node.outputs[0])
        return (
            shape is not None
            and 0 not in shape
            and is_op(node.inputs[0].producer(), *_RESHAPE_OPERATORS)
        )

    def replace(self, node: ir.Node) -> None:
        """Replace consecutive reshaping nodes by one Reshape of the first one's input."""
        write, shape = InsertionPoint(node), required(fixed_shape(node.outputs[0]))
        x = node.inputs[0]
        while x is not None and is_op(x.producer(), *_RESHAPE_OPERATORS):
            producer = required(x.producer())
            x = producer.inputs[0]
        assert x is not None
        write.replace(write.op("Reshape", x, write.int64(*shape), shape=ir.Shape(shape)))
