"""Masks of zeros and ones, where a release cannot compute with booleans."""

__all__ = ["ArithmeticMasks"]

from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import Substitute, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of

_BOOL, _FLOAT = ir.DataType.BOOL, ir.DataType.FLOAT
_LOGIC = ("And", "Equal", "Or", "Xor")
_JOINING = ("Concat",)
# Set on tensors of this pass: they hold zeros and ones, and nothing else.
_MARK = "gsgen.mask"


class ArithmeticMasks(Substitute):
    """Compute with masks as numbers where a release has no kernel for booleans.

    No release joins, turns, pads or compares booleans, and onnxruntime-web 1.22 does not reshape
    them either; a mask falls to the CPU on its way from a comparison to a Where::

        Or(a, b)                  →   Cast<to bool>(a + b − a · b), of zeros and ones
        Unsqueeze(mask: bool)     →   Cast<to bool>(Unsqueeze(Cast<to float>(mask)))

    Numbers are kept between two such operators, so that a chain of them casts once at each end.
    """

    name: ClassVar[str] = "arithmetic-masks"
    wanted_by: ClassVar[str] = "targets whose tables lack operators of booleans"
    kinds: ClassVar[frozenset[str]] = frozenset(
        {
            *("And", "Concat", "Equal", "Expand", "Flatten", "Gather", "GatherElements"),
            *(
                "GatherND",
                "Or",
                "Reshape",
                "Slice",
                "Split",
                "Squeeze",
                "Tile",
                "Transpose",
            ),
            *("Unsqueeze", "Where", "Xor"),
        }
    )

    def matches(self, node: ir.Node) -> bool:
        """Say whether ``node`` lacks a kernel for booleans, or undoes a cast of this pass."""
        return super().matches(node) or _undoes(node)

    def suits(self, node: ir.Node) -> bool:
        """Say whether what it computes with is boolean."""
        # What a Where chooses by is boolean always, and stays so.
        value = node.inputs[_places_of(node)[0]]
        return value is not None and value.dtype == _BOOL

    def replace(self, node: ir.Node) -> None:
        """Compute with numbers."""
        write = InsertionPoint(node)
        if _undoes(node):
            write.replace(_recast(write, node))
            return
        places = _places_of(node)
        numbers = {place: _number(write, node.inputs[place]) for place in places}
        if is_op(node, *_LOGIC):
            made = [_logic(write, node.op_type, *numbers.values())]
        else:
            inputs = [numbers.get(place, value) for place, value in enumerate(node.inputs)]
            attributes = {key: one.value for key, one in node.attributes.items()}
            made = write.ops(node.op_type, len(node.outputs), *inputs, **attributes)
        for old, value in zip(node.outputs, made, strict=True):
            value.type, value.shape = ir.TensorType(_FLOAT), old.shape
            value.meta[_MARK] = True
        write.replace(
            *(
                write.op("Cast", one, dtype=_BOOL, shape=one.shape, to=int(_BOOL))
                for one in made
            )
        )


def _places_of(node: ir.Node) -> range:
    """Return which arguments ``node`` computes with; the others are indices, shapes and tests."""
    if is_op(node, *_LOGIC, *_JOINING):
        return range(len(node.inputs))
    return range(1, 3) if is_op(node, "Where") else range(1)


def _number(write: InsertionPoint, value: ir.Value | None) -> ir.Value:
    """Return ``value`` as zeros and ones."""
    assert value is not None
    maker = value.producer()
    if is_op(maker, "Cast") and maker is not None:
        inner = maker.inputs[0]
        if inner is not None and inner.meta.get(_MARK):
            return inner
    known = constant_of(value)
    if known is not None:
        made = write.constant(known.astype(np.float32), "mask")
    else:
        made = write.op("Cast", value, dtype=_FLOAT, shape=value.shape, to=int(_FLOAT))
    made.meta[_MARK] = True
    return made


def _logic(write: InsertionPoint, kind: str, *numbers: ir.Value) -> ir.Value:
    a, b = numbers
    if kind == "And":
        return write.op("Mul", a, b)
    if kind == "Or":
        return write.op("Sub", write.op("Add", a, b), write.op("Mul", a, b))
    apart = write.op("Abs", write.op("Sub", a, b))
    if kind == "Xor":
        return apart
    return write.op("Sub", write.constant(np.ones((), np.float32), "one"), apart)


def _undoes(node: ir.Node) -> bool:
    """Say whether ``node`` casts a mask to numbers that this pass has cast to booleans."""
    value = node.inputs[0] if is_op(node, "Cast") else None
    maker = value.producer() if value is not None else None
    if value is None or maker is None or not is_op(maker, "Cast") or value.dtype != _BOOL:
        return False
    inner = maker.inputs[0]
    return inner is not None and bool(inner.meta.get(_MARK))


def _recast(write: InsertionPoint, node: ir.Node) -> ir.Value:
    maker = node.inputs[0].producer() if node.inputs[0] is not None else None
    assert maker is not None
    inner, kind = maker.inputs[0], node.outputs[0].dtype
    assert inner is not None
    assert kind is not None
    if kind == inner.dtype:
        return inner
    made = write.op("Cast", inner, dtype=kind, shape=inner.shape, to=int(kind))
    return made
