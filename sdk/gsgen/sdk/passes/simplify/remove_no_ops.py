"""Removes operators that return their input unchanged."""

__all__ = ["RemoveNoOps"]


import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute, required

_VARIADIC_OPERATORS = frozenset({"Concat", "Max", "Mean", "Min", "Sum"})
_REDUCTION_OPERATORS = frozenset(
    {"ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum"}
)
# If the shape does not change, neither does the order of the elements.
_ORDER_KEEPING_OPERATORS = frozenset({"Expand", "Flatten", "Reshape", "Squeeze", "Unsqueeze"})
# The neutral second operand; for Mul, also the neutral first operand.
_NEUTRAL_BY_OPERATOR = {"Div": 1, "Mul": 1, "Sub": 0}


class RemoveNoOps(NodeRewrite):
    """Remove operators that return their input unchanged.

    Exporters leave many: a Cast to the same dtype, an Expand to the same shape, a Concat of one
    tensor. Each costs a launch on a GPU and a copy on the CPU. Worse, a ReduceSum over no axis and
    a Max of one input are buffer copies, which graph capture does not record: an output after one
    of them repeats the first frame forever::

        Max(x), ReduceSum<noop_with_empty_axes>(x), Cast<to float>(x), x · 1   →   x
    """

    name = "drop-idle"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node returns an input unchanged and can be removed."""
        x = next(iter(node.inputs), None)
        if x is None or not node.outputs or any(output.uses() for output in node.outputs[1:]):
            return False
        if any(output.is_graph_output() for output in node.outputs[1:]):
            return False
        producer = x.producer()
        is_in_own_graph = producer is not None and producer.graph is node.graph
        if node.outputs[0].is_graph_output() and (not is_in_own_graph or x.is_graph_output()):
            return False
        return _unchanged_operand(node) is not None

    def replace(self, node: ir.Node) -> None:
        """Replace the output of a removed operator by the unchanged input."""
        argument = required(
            _unchanged_operand(node)
        )  # not stored: another replacement may have changed it
        write = InsertionPoint(node)
        for unused_output in node.outputs[1:]:
            unused_output.name = None
        node.resize_outputs(1)
        write.replace(argument)


def _unchanged_operand(node: ir.Node) -> ir.Value | None:
    """Return the input that a node returns unchanged; None if the node changes all inputs."""
    x = node.inputs[0]
    if x is None:
        return None
    if is_op(node, "Identity", *_VARIADIC_OPERATORS):
        return x if len(node.inputs) == 1 else None
    if is_op(node, "Dropout"):
        training_mode = node.inputs[2] if len(node.inputs) > 2 else None
        mode = constant_of(training_mode)
        return x if training_mode is None or (mode is not None and not mode.any()) else None
    if is_op(node, "Cast", "CastLike"):
        return x if x.dtype is not None and x.dtype == node.outputs[0].dtype else None
    if is_op(node, *_REDUCTION_OPERATORS):
        return x if _is_empty_reduction(node) else None
    if is_op(node, *_NEUTRAL_BY_OPERATOR):
        return _neutral_operand_partner(node)
    shape, result_shape = fixed_shape(x), fixed_shape(node.outputs[0])
    if shape is None or shape != result_shape:
        return None
    if is_op(node, *_ORDER_KEEPING_OPERATORS):
        return x
    return x if _keeps_positions(node, len(shape)) else None


def _is_empty_reduction(node: ir.Node) -> bool:
    if "axes" in node.attributes or not int_attribute(node, "noop_with_empty_axes", 0):
        return False
    axes_input = node.inputs[1] if len(node.inputs) > 1 else None
    axes = constant_of(axes_input)
    return axes_input is None or (axes is not None and axes.size == 0)


def _neutral_operand_partner(node: ir.Node) -> ir.Value | None:
    """Return the operand of x + 0 or x · 1 that the other operand does not change."""
    if node.outputs[0].is_graph_output():
        return None  # intended: outputs end on such an operator
    pairs = [(node.inputs[0], node.inputs[1])]
    if node.op_type == "Mul":
        pairs.append((node.inputs[1], node.inputs[0]))
    shape = fixed_shape(node.outputs[0])
    for operand, neutral_number in pairs:
        number = constant_of(neutral_number)
        is_neutral_operand = number is not None and bool(
            (number == _NEUTRAL_BY_OPERATOR[node.op_type]).all()
        )
        if (
            is_neutral_operand
            and number is not None
            and number.size
            and shape == fixed_shape(operand) is not None
        ):
            return operand
    return None


def _keeps_positions(node: ir.Node, rank: int) -> bool:
    """Return whether an operator such as Transpose leaves all elements at their positions."""
    if is_op(node, "Transpose"):
        perm = node.attributes.get("perm")
        order = list(range(rank))
        return (list(perm.as_ints()) if perm is not None else order[::-1]) == order
    if is_op(node, "Tile"):
        return True  # an equal shape means that nothing is repeated
    if is_op(node, "Slice"):
        step_input = node.inputs[4] if len(node.inputs) > 4 else None
        steps = constant_of(step_input)
        return step_input is None or (steps is not None and bool((steps == 1).all()))
    if is_op(node, "Pad") and len(node.inputs) > 1:
        pad_sizes = constant_of(node.inputs[1])
        return pad_sizes is not None and not pad_sizes.any()
    return False
