"""Gives single numbers as many axes as the tensor that they are broadcast to."""

__all__ = ["WidenNumbers"]

from math import prod

import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, required

_BROADCAST_OPERATORS = (
    *("Add", "Sub", "Mul", "Div", "Max", "Min", "Where", "Equal"),
    *("Greater", "GreaterOrEqual", "Less", "LessOrEqual"),
)
# The number of elements from which the time of a Reshape does not count.
_MIN_ELEMENTS = 1 << 12


class WidenNumbers(NodeRewrite):
    """Give a number that is combined with a tensor of a last axis of one as many axes.

    ONNX Runtime's CPU kernels pair the axes of both operands from the last one on. If the tensor
    has an axis of one there, such as opacities [N, 1], and the number has fewer axes, they compute
    one element at a time: 20 to 50 times as slowly (measured with 1.31)::

        Mul(x [N, 4, 1], c [])   →   Mul(x [N, 4, 1], c [1, 1, 1])

    A number that is computed, such as the time, gets its axes by a Reshape.
    """

    name = "widen-numbers"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node broadcasts a number of fewer axes over a last axis of one."""
        return bool(_narrow_numbers(node))

    def replace(self, node: ir.Node) -> None:
        """Give the numbers of a node as many axes as its result has."""
        write, rank = InsertionPoint(node), len(required(fixed_shape(node.outputs[0])))
        for index in _narrow_numbers(node):
            number = required(node.inputs[index])
            known = constant_of(number)
            if known is None:
                wide = write.op("Reshape", number, write.int64(*[1] * rank), shape=[1] * rank)
            else:
                wide = write.constant(known.reshape([1] * rank), "number")
            node.replace_input_with(index, wide)


def _narrow_numbers(node: ir.Node) -> list[int]:
    """Return the indices of a node's operands that are numbers with too few axes."""
    shape = fixed_shape(node.outputs[0]) if is_op(node, *_BROADCAST_OPERATORS) else None
    if not shape or shape[-1] != 1 or prod(shape) < _MIN_ELEMENTS:
        return []
    operands = [fixed_shape(value) for value in node.inputs]
    return [
        index
        for index, operand in enumerate(operands)
        if operand is not None and prod(operand) == 1 and len(operand) < len(shape)
    ]
