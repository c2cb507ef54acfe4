"""Operators that return what they take."""

__all__ = ["RemoveNoOps"]

from typing import ClassVar

import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute

_OF_ONE = frozenset({"Concat", "Max", "Mean", "Min", "Sum"})
_REDUCTIONS = frozenset({"ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum"})
# Where the shape is the same, so is the order of the elements.
_KEEP_ORDER = frozenset({"Expand", "Flatten", "Reshape", "Squeeze", "Unsqueeze"})
# What changes nothing as the second argument, and as the first, too, where order is of no matter.
_NEUTRAL = {"Div": 1, "Mul": 1, "Sub": 0}


class RemoveNoOps(NodeRewrite):
    """Drop operators that return their argument as it is.

    Exporters leave many: a Cast to the dtype that is there already, an Expand to the same shape, a
    Concat of one. Each costs a launch on a GPU and a copy on the CPU. Worse, a ReduceSum over no
    axis and a Max of one argument are buffer copies, which graph capture does not record: in front
    of an output they repeat the first frame for ever::

        Max(x), ReduceSum<noop_with_empty_axes>(x), Cast<to float>(x), x · 1   →   x
    """

    name: ClassVar[str] = "drop-idle"

    def matches(self, node: ir.Node) -> bool:
        """Say whether ``node`` is idle, and need not stand between an input and an output."""
        x = next(iter(node.inputs), None)
        if x is None or not node.outputs or any(one.uses() for one in node.outputs[1:]):
            return False
        if any(one.is_graph_output() for one in node.outputs[1:]):
            return False
        producer = x.producer()
        fresh = producer is not None and producer.graph is node.graph
        if node.outputs[0].is_graph_output() and (not fresh or x.is_graph_output()):
            return False
        return _argument(node) is not None

    def replace(self, node: ir.Node) -> None:
        """Let its argument take its place."""
        kept = _argument(node)  # asked again: another replacement may have changed it
        assert kept is not None
        write = InsertionPoint(node)
        for spare in node.outputs[1:]:
            spare.name = None
        node.resize_outputs(1)
        write.replace(kept)


def _argument(node: ir.Node) -> ir.Value | None:
    """Return what ``node`` returns as it is; None where it does something."""
    x = node.inputs[0]
    if x is None:
        return None
    if is_op(node, "Identity", *_OF_ONE):
        return x if len(node.inputs) == 1 else None
    if is_op(node, "Dropout"):
        training = node.inputs[2] if len(node.inputs) > 2 else None
        mode = constant_of(training)
        return x if training is None or (mode is not None and not mode.any()) else None
    if is_op(node, "Cast", "CastLike"):
        return x if x.dtype is not None and x.dtype == node.outputs[0].dtype else None
    if is_op(node, *_REDUCTIONS):
        return x if _reduces_nothing(node) else None
    if is_op(node, *_NEUTRAL):
        return _other_than_neutral(node)
    shape, made = fixed_shape(x), fixed_shape(node.outputs[0])
    if shape is None or shape != made:
        return None
    if is_op(node, *_KEEP_ORDER):
        return x
    return x if _moves_nothing(node, len(shape)) else None


def _reduces_nothing(node: ir.Node) -> bool:
    if "axes" in node.attributes or not int_attribute(node, "noop_with_empty_axes", 0):
        return False
    given = node.inputs[1] if len(node.inputs) > 1 else None
    axes = constant_of(given)
    return given is None or (axes is not None and axes.size == 0)


def _other_than_neutral(node: ir.Node) -> ir.Value | None:
    """Return the argument that the other, being all ones or zeros, leaves as it is."""
    if node.outputs[0].is_graph_output():
        return None  # it may stand there on purpose: outputs end on it
    pairs = [(node.inputs[0], node.inputs[1])]
    if node.op_type == "Mul":
        pairs.append((node.inputs[1], node.inputs[0]))
    shape = fixed_shape(node.outputs[0])
    for kept, other in pairs:
        number = constant_of(other)
        idle = number is not None and bool((number == _NEUTRAL[node.op_type]).all())
        if (
            idle
            and number is not None
            and number.size
            and shape == fixed_shape(kept) is not None
        ):
            return kept
    return None


def _moves_nothing(node: ir.Node, rank: int) -> bool:
    """Say whether an operator that moves elements leaves them where they are."""
    if is_op(node, "Transpose"):
        perm = node.attributes.get("perm")
        order = list(range(rank))
        return (list(perm.as_ints()) if perm is not None else order[::-1]) == order
    if is_op(node, "Tile"):
        return True  # the same shape means that nothing is repeated
    if is_op(node, "Slice"):
        given = node.inputs[4] if len(node.inputs) > 4 else None
        steps = constant_of(given)
        return given is None or (steps is not None and bool((steps == 1).all()))
    if is_op(node, "Pad") and len(node.inputs) > 1:
        pads = constant_of(node.inputs[1])
        return pads is not None and not pads.any()
    return False
