"""Integers of 32 bits where nothing needs 64."""

__all__ = ["NarrowIntegers"]

from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.contract.model.value_ranges import Interval
from gsgen.sdk.passes.framework.base import ByTables, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.gather_spans import fits_int32, spans_of
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of

_WIDE, _NARROW = ir.DataType.INT64, ir.DataType.INT32
# Operator → the arguments that it computes with; None is all of them.
_COMPUTES: dict[str, tuple[int, ...] | None] = {
    **dict.fromkeys(("Add", "Sub", "Mul", "Div", "Neg", "Abs", "Min", "Max", "Clip")),
    **dict.fromkeys(("Equal", "Less", "LessOrEqual", "Greater", "GreaterOrEqual")),
    **dict.fromkeys(("Concat", "Mod", "Sign", "Identity", "Relu")),
    **dict.fromkeys(("Reshape", "Squeeze", "Unsqueeze", "Expand", "Tile", "Flatten"), (0,)),
    **dict.fromkeys(("Slice", "Gather", "GatherElements", "GatherND", "Transpose"), (0,)),
    **dict.fromkeys(("Split", "ReduceSum", "ReduceMax", "ReduceMin", "CumSum"), (0,)),
    "Pad": (0, 2),
    "Where": (1, 2),
    "Cast": (0,),
}
_INDEXED = ("Gather", "GatherElements", "ScatterElements")
# Whole numbers up to this are float32, too.
_EXACT_FLOAT = 1 << 24


class NarrowIntegers(ByTables, CautiousRewrite):
    """Compute in int32 what is int64 and cannot leave the range of int32.

    WebGPU has no integers of 64 bits. Few releases take them by way of 32 bits and truncate; in
    onnxruntime-web 1.22 the rest falls to the CPU, or repeats the first frame. Only what range
    analysis proves to fit is rewritten: weights, declared ranges of inputs, and what bounds follow
    through the graph::

        Add(Cast<to int64>(x), 1: int64)   →   Cast<to int64>(Add(Cast<to int32>(x), 1: int32))

    Casts between two such operators cancel each other (pass ``merge-casts``), and operators that
    look up by index take the int32 as it is. A sum or an extreme that has no kernel for int32 is
    taken of floats where those are exact, below 2²⁴.
    """

    name: ClassVar[str] = "narrow-integers"
    wanted_by: ClassVar[str] = "targets whose tables lack operators of int64"

    def rewrite(self, model: ir.Model) -> None:
        """Narrow every operator of the main graph that can be."""
        spans = spans_of(model, self.goal.manifest if self.goal else None)
        for node in _frame_nodes(model.graph):
            if self._wants(node):
                self._narrow(node, spans)
            elif self._sums_integers(node):
                self._sum_floats(node, spans)
        for node in model.graph.all_nodes():
            self._index(node)

    def _wants(self, node: ir.Node) -> bool:
        """Say whether ``node`` computes in int64, and a release does not capture it."""
        if not is_op(node, *_COMPUTES):
            return False
        values = [*_computed(node), *node.outputs]
        if not any(value is not None and value.dtype == _WIDE for value in values):
            return False
        if self.goal is None:
            return not _undone(node)
        made = node.outputs[0].dtype
        variant = f"to {made.numpy()}" if is_op(node, "Cast") and made is not None else ""
        return self.goal.lacks(node, self.opset, variant) and not _undone(node)

    def _narrow(self, node: ir.Node, spans: dict[str, Interval]) -> None:
        values = [value for value in (*_computed(node), *node.outputs) if value is not None]
        for value in values:
            if value.dtype == _WIDE and not fits_int32(spans.get(value.name or "")):
                self.refuse(node, f"{value.name} may leave the range of int32")
                return
        self.note(node)
        write = InsertionPoint(node)
        places = _COMPUTES[node.op_type]
        inputs = [
            _narrowed(write, value) if places is None or index in places else value
            for index, value in enumerate(node.inputs)
        ]
        attributes = {key: one.value for key, one in node.attributes.items()}
        if is_op(node, "Cast") and node.outputs[0].dtype == _WIDE:
            attributes["to"] = int(_NARROW)
        made = write.ops(node.op_type, len(node.outputs), *inputs, **attributes)
        back = []
        for old, value in zip(node.outputs, made, strict=True):
            wide = old.dtype == _WIDE
            value.type = ir.TensorType(_NARROW) if wide else old.type
            value.shape = old.shape
            back.append(_cast(write, value, _WIDE) if wide else value)
            if old.name in spans:
                spans |= dict.fromkeys(
                    (value.name or "", back[-1].name or ""), spans[old.name]
                )
        write.replace(*back)

    def _sums_integers(self, node: ir.Node) -> bool:
        """Say whether ``node`` reduces int32, for which a release has no kernel."""
        if not is_op(node, "ReduceSum", "ReduceMax", "ReduceMin") or self.goal is None:
            return False
        value = node.inputs[0]
        return (
            value is not None
            and value.dtype == _NARROW
            and self.goal.lacks(node, self.opset)
        )

    def _sum_floats(self, node: ir.Node, spans: dict[str, Interval]) -> None:
        for value in (node.inputs[0], node.outputs[0]):
            if value is None or not fits_int32(spans.get(value.name or ""), _EXACT_FLOAT):
                self.refuse(node, "floats might not be exact there")
                return
        self.note(node)
        write = InsertionPoint(node)
        attributes = {key: one.value for key, one in node.attributes.items()}
        taken = _cast(write, node.inputs[0], ir.DataType.FLOAT)
        made = write.op(node.op_type, taken, *node.inputs[1:], **attributes)
        made.shape = node.outputs[0].shape
        write.replace(_cast(write, made, _NARROW))

    def _index(self, node: ir.Node) -> None:
        """Let an operator look up by the int32 that was cast to int64 for it."""
        if not is_op(node, *_INDEXED) or node.inputs[1] is None:
            return
        maker = node.inputs[1].producer()
        if maker is None or not is_op(maker, "Cast") or maker.graph is not node.graph:
            return
        inner = maker.inputs[0]
        if inner is not None and inner.dtype == _NARROW and node.inputs[1].dtype == _WIDE:
            node.replace_input_with(1, inner)
            self.note(node)


def _frame_nodes(graph: ir.Graph) -> list[ir.Node]:
    """Return the nodes that depend on an input; the others are computed once, at loading."""
    varying = {value for value in graph.inputs if value.name not in graph.initializers}
    found = []
    for node in graph:
        if varying.intersection(value for value in node.inputs if value is not None):
            varying.update(node.outputs)
            found.append(node)
    return found


def _computed(node: ir.Node) -> list[ir.Value | None]:
    places = _COMPUTES[node.op_type]
    return [v for k, v in enumerate(node.inputs) if places is None or k in places]


def _undone(node: ir.Node) -> bool:
    """Say whether ``node`` is a cast between the two sorts of integers, as this pass leaves them."""
    value = node.inputs[0]
    kinds = {None if value is None else value.dtype, node.outputs[0].dtype}
    return is_op(node, "Cast") and kinds == {_WIDE, _NARROW}


def _narrowed(write: InsertionPoint, value: ir.Value | None) -> ir.Value | None:
    if value is None or value.dtype != _WIDE:
        return value
    known = constant_of(value)
    if known is not None:
        return write.constant(known.astype(np.int32), "narrow")
    return _cast(write, value, _NARROW)


def _cast(write: InsertionPoint, value: ir.Value | None, kind: ir.DataType) -> ir.Value:
    assert value is not None
    return write.op("Cast", value, dtype=kind, shape=value.shape, to=int(kind))
