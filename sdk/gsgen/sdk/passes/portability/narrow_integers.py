"""Replaces int64 arithmetic by int32 if the values provably fit."""

__all__ = ["NarrowIntegers"]


import numpy as np
import onnx_ir as ir

from gsgen.contract.model.value_ranges import Interval
from gsgen.sdk.passes.framework.base import TableRewrite, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.gather_spans import fits_int32, spans_of
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import attribute_values, constant_of

_INT64, _INT32 = ir.DataType.INT64, ir.DataType.INT32
# Operator → the indices of its operands; None means all inputs.
_COMPUTED_INPUTS: dict[str, tuple[int, ...] | None] = {
    **dict.fromkeys(("Add", "Sub", "Mul", "Div", "Neg", "Abs", "Min", "Max", "Clip")),
    **dict.fromkeys(("Equal", "Less", "LessOrEqual", "Greater", "GreaterOrEqual")),
    **dict.fromkeys(("Concat", "Mod", "Pow", "Sign", "Identity", "Relu")),
    **dict.fromkeys(("Reshape", "Squeeze", "Unsqueeze", "Expand", "Tile", "Flatten"), (0,)),
    **dict.fromkeys(("Slice", "Gather", "GatherElements", "GatherND", "Transpose"), (0,)),
    **dict.fromkeys(("Split", "ReduceSum", "ReduceMax", "ReduceMin", "CumSum"), (0,)),
    "Pad": (0, 2),
    "Where": (1, 2),
    "Cast": (0,),
}
_INDEXED_OPERATORS = ("Gather", "GatherElements", "ScatterElements")
# float32 represents every integer up to this number.
_MAX_EXACT_FLOAT32_INTEGER = 1 << 24


class NarrowIntegers(TableRewrite, SkippableRewrite):
    """Compute int64 values in int32 if they provably fit.

    WebGPU has no 64-bit integers. Few releases truncate them to 32 bits; in onnxruntime-web 1.22
    the other operators fall back to the CPU, or repeat the first frame. A node is rewritten only if
    range analysis proves that its values fit, from weights and the declared ranges of inputs::

        1  Add(Cast<to int64>(x), 1: int64)   →   Cast<to int64>(Add(Cast<to int32>(x), 1: int32))
           Pow(x: float, i: int64)            →   Pow(x: float, Cast<to int32>(i))
        2  ReduceSum(i: int32)                →   Cast<to int32>(ReduceSum(Cast<to float>(i)))
        3  Gather(t, Cast<to int64>(i))       →   Gather(t, i: int32)

    Casts between two such operators cancel each other (pass ``merge-casts``). Case 2 needs a
    target without int32 kernels for reductions, and numbers below 2²⁴, where floats are exact.
    """

    name = "narrow-integers"
    wanted_by = "targets whose tables lack operators of int64"

    def rewrite(self, model: ir.Model) -> None:
        """Narrow int64 operators of the main graph whose values provably fit int32."""
        spans = spans_of(model, self.target.manifest if self.target else None)
        for node in _frame_nodes(model.graph):
            if self._can_narrow(node):  # Case 1
                self._narrow_node(node, spans)
            elif self._sums_integers(node):  # Case 2
                self._sum_floats(node, spans)
        for node in model.graph.all_nodes():
            self._use_narrow_index(node)  # Case 3

    def _can_narrow(self, node: ir.Node) -> bool:
        """Return whether a node computes in int64 where the target does not capture int64."""
        if not is_op(node, *_COMPUTED_INPUTS):
            return False
        values = [*_computed_inputs(node), *node.outputs]
        if not any(value is not None and value.dtype == _INT64 for value in values):
            return False
        if self.target is None:
            return not _is_integer_cast(node)
        result_dtype = node.outputs[0].dtype
        variant = (
            f"to {result_dtype.numpy()}" if is_op(node, "Cast") and result_dtype is not None else ""
        )
        return self.target.lacks_kernel(node, self.opset, variant) and not _is_integer_cast(node)

    def _narrow_node(self, node: ir.Node, spans: dict[str, Interval]) -> None:
        values = [value for value in (*_computed_inputs(node), *node.outputs) if value is not None]
        for value in values:
            if value.dtype == _INT64 and not fits_int32(spans.get(value.name or "")):
                self.refuse(node, f"{value.name} may leave the range of int32")
                return
        self.note(node)
        write = InsertionPoint(node)
        indices = _COMPUTED_INPUTS[node.op_type]
        inputs = [
            _cast_to_int32(write, value) if indices is None or index in indices else value
            for index, value in enumerate(node.inputs)
        ]
        attributes = attribute_values(node)
        if is_op(node, "Cast") and node.outputs[0].dtype == _INT64:
            attributes["to"] = int(_INT32)
        results = write.ops(node.op_type, len(node.outputs), *inputs, **attributes)
        outputs = []
        for old, value in zip(node.outputs, results, strict=True):
            is_int64_before = old.dtype == _INT64
            value.type = ir.TensorType(_INT32) if is_int64_before else old.type
            value.shape = old.shape
            outputs.append(_write_cast(write, value, _INT64) if is_int64_before else value)
            if old.name in spans:
                spans |= dict.fromkeys((value.name or "", outputs[-1].name or ""), spans[old.name])
        write.replace(*outputs)

    def _sums_integers(self, node: ir.Node) -> bool:
        """Return whether a node sums int32 numbers, for which the runtime has no kernel."""
        if not is_op(node, "ReduceSum", "ReduceMax", "ReduceMin") or self.target is None:
            return False
        value = node.inputs[0]
        return (
            value is not None
            and value.dtype == _INT32
            and self.target.lacks_kernel(node, self.opset)
        )

    def _sum_floats(self, node: ir.Node, spans: dict[str, Interval]) -> None:
        for value in (node.inputs[0], node.outputs[0]):
            if value is None or not fits_int32(
                spans.get(value.name or ""), _MAX_EXACT_FLOAT32_INTEGER
            ):
                self.refuse(node, "its numbers may exceed 2²⁴, so floats might not be exact")
                return
        self.note(node)
        write = InsertionPoint(node)
        attributes = attribute_values(node)
        floats = _write_cast(write, node.inputs[0], ir.DataType.FLOAT)
        reduced = write.op(node.op_type, floats, *node.inputs[1:], **attributes)
        reduced.shape = node.outputs[0].shape
        write.replace(_write_cast(write, reduced, _INT32))

    def _use_narrow_index(self, node: ir.Node) -> None:
        """Pass int32 indices to a node directly, without a Cast to int64."""
        if not is_op(node, *_INDEXED_OPERATORS) or node.inputs[1] is None:
            return
        source_node = node.inputs[1].producer()
        if (
            source_node is None
            or not is_op(source_node, "Cast")
            or source_node.graph is not node.graph
        ):
            return
        source = source_node.inputs[0]
        if source is not None and source.dtype == _INT32 and node.inputs[1].dtype == _INT64:
            node.replace_input_with(1, source)
            self.note(node)


def _frame_nodes(graph: ir.Graph) -> list[ir.Node]:
    """Return the graph nodes that depend on an input; others are computed once, at loading."""
    varying_values = {value for value in graph.inputs if value.name not in graph.initializers}
    nodes = []
    for node in graph:
        if varying_values.intersection(value for value in node.inputs if value is not None):
            varying_values.update(node.outputs)
            nodes.append(node)
    return nodes


def _computed_inputs(node: ir.Node) -> list[ir.Value | None]:
    indices = _COMPUTED_INPUTS[node.op_type]
    return [v for k, v in enumerate(node.inputs) if indices is None or k in indices]


def _is_integer_cast(node: ir.Node) -> bool:
    """Return whether a node is a Cast between int32 and int64."""
    value = node.inputs[0]
    kinds = {None if value is None else value.dtype, node.outputs[0].dtype}
    return is_op(node, "Cast") and kinds == {_INT64, _INT32}


def _cast_to_int32(write: InsertionPoint, value: ir.Value | None) -> ir.Value | None:
    if value is None or value.dtype != _INT64:
        return value
    known = constant_of(value)
    if known is not None:
        return write.constant(known.astype(np.int32), "narrow")
    return _write_cast(write, value, _INT32)


def _write_cast(write: InsertionPoint, value: ir.Value | None, kind: ir.DataType) -> ir.Value:
    assert value is not None
    return write.op("Cast", value, dtype=kind, shape=value.shape, to=int(kind))
