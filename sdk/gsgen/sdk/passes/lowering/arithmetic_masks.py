"""Rewrites boolean operators as arithmetic on 0 and 1, for runtimes without boolean kernels."""

__all__ = ["ArithmeticMasks"]


import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import SubstituteNodes, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import attribute_values, constant_of, required

_BOOL, _FLOAT = ir.DataType.BOOL, ir.DataType.FLOAT
_LOGIC_OPERATORS = ("And", "Equal", "Or", "Xor")
_CONCAT_OPERATORS = ("Concat",)
# Metadata key of tensors that this pass created and that hold only zeros and ones.
_MASK_KEY = "gsgen.mask"


class ArithmeticMasks(SubstituteNodes):
    """Compute boolean masks as numbers, for runtime releases without boolean kernels.

    No release joins, transposes, pads or compares booleans, and onnxruntime-web 1.22 does not
    reshape them either; between a comparison and a Where, a mask falls back to the CPU::

        1  Or(a, b)                →   Cast<to bool>(a + b − a · b), of zeros and ones
        2  Unsqueeze(mask: bool)   →   Cast<to bool>(Unsqueeze(Cast<to float>(mask)))
        3  Cast<to float>(Cast<to bool>(x)), where case 1 or 2 wrote the inner Cast   →   x

    Case 3 keeps numbers between two such operators: a chain of them casts only at its ends.
    """

    name = "arithmetic-masks"
    wanted_by = "targets whose tables lack operators of booleans"
    kinds = frozenset({
        "And", "Concat", "Equal", "Expand", "Flatten", "Gather", "GatherElements",
        "GatherND", "Or", "Reshape", "Slice", "Split", "Squeeze", "Tile", "Transpose",
        "Unsqueeze", "Where", "Xor",
    })  # fmt: skip

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node lacks a boolean kernel, or casts a boolean mask to numbers."""
        return super().matches(node) or _undoes_mask_cast(node)

    def can_replace(self, node: ir.Node) -> bool:
        """Return whether the operands of the node are boolean."""
        # The condition of a Where is always boolean, and stays boolean.
        value = node.inputs[_computed_inputs(node)[0]]
        return value is not None and value.dtype == _BOOL

    def replace(self, node: ir.Node) -> None:
        """Replace a boolean operator by arithmetic on zeros and ones."""
        write = InsertionPoint(node)
        if _undoes_mask_cast(node):  # Case 3
            write.replace(_cast_mask(write, node))
            return
        indices = _computed_inputs(node)
        numbers = {index: _as_number(write, node.inputs[index]) for index in indices}
        if is_op(node, *_LOGIC_OPERATORS):  # Case 1: an operator that computes with truth values
            results = [_write_logic_operator(write, node.op_type, *numbers.values())]
        else:  # Case 2: an operator that moves elements
            inputs = [numbers.get(index, value) for index, value in enumerate(node.inputs)]
            attributes = attribute_values(node)
            results = write.ops(node.op_type, len(node.outputs), *inputs, **attributes)
        for old, value in zip(node.outputs, results, strict=True):
            value.type, value.shape = ir.TensorType(_FLOAT), old.shape
            value.meta[_MASK_KEY] = True
        write.replace(
            *(
                write.op("Cast", result, dtype=_BOOL, shape=result.shape, to=int(_BOOL))
                for result in results
            )
        )


def _computed_inputs(node: ir.Node) -> range:
    """Return the indices of a node's numeric operands, without shapes, indices and conditions."""
    if is_op(node, *_LOGIC_OPERATORS, *_CONCAT_OPERATORS):
        return range(len(node.inputs))
    return range(1, 3) if is_op(node, "Where") else range(1)


def _as_number(write: InsertionPoint, value: ir.Value | None) -> ir.Value:
    """Return a boolean tensor of the graph as float zeros and ones."""
    assert value is not None
    source_node = value.producer()
    if is_op(source_node, "Cast") and source_node is not None:
        source = source_node.inputs[0]
        if source is not None and source.meta.get(_MASK_KEY):
            return source
    known = constant_of(value)
    if known is not None:
        number = write.constant(known.astype(np.float32), "mask")
    else:
        number = write.op("Cast", value, dtype=_FLOAT, shape=value.shape, to=int(_FLOAT))
    number.meta[_MASK_KEY] = True
    return number


def _write_logic_operator(write: InsertionPoint, kind: str, *numbers: ir.Value) -> ir.Value:
    a, b = numbers
    if kind == "And":
        return write.op("Mul", a, b)
    if kind == "Or":
        return write.op("Sub", write.op("Add", a, b), write.op("Mul", a, b))
    difference = write.op("Abs", write.op("Sub", a, b))
    if kind == "Xor":
        return difference
    return write.op("Sub", write.constant(np.ones((), np.float32), "one"), difference)


def _undoes_mask_cast(node: ir.Node) -> bool:
    """Return whether a node casts a mask to numbers right after a cast of numbers to booleans."""
    value = node.inputs[0] if is_op(node, "Cast") else None
    source_node = value.producer() if value is not None else None
    if (
        value is None
        or source_node is None
        or not is_op(source_node, "Cast")
        or value.dtype != _BOOL
    ):
        return False
    source = source_node.inputs[0]
    return source is not None and bool(source.meta.get(_MASK_KEY))


def _cast_mask(write: InsertionPoint, node: ir.Node) -> ir.Value:
    source_node = required(node.inputs[0].producer() if node.inputs[0] is not None else None)
    source, kind = required(source_node.inputs[0]), required(node.outputs[0].dtype)
    if kind == source.dtype:
        return source
    cast_value = write.op("Cast", source, dtype=kind, shape=source.shape, to=int(kind))
    return cast_value
