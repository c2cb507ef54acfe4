"""Replaces arithmetic on tensor shapes by constants."""

__all__ = ["FoldShapes"]


import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.sdk.passes.framework.base import every_node, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.graph_builder import replace_value, weight
from gsgen.sdk.passes.framework.shape_arithmetic import evaluate
from gsgen.sdk.passes.framework.shape_inference import infer_shapes
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute

# A shape has a few numbers; a table of row numbers, which no GPU kernel computes, may have many.
_MAX_FOLDED_SIZE = 1 << 12
_MAX_SIZE = 1 << 24
_TABLE_OPERATORS = ("ConstantOfShape", "Range")


class FoldShapes(SkippableRewrite):
    """Replace arithmetic on shapes by its result if the result is the same in every frame.

    Range and ConstantOfShape have no WebGPU kernel, and a Reshape to a shape that the frame
    computes cannot be captured. Once sizes are fixed, such chains are constants::

        Shape → Gather → Concat → Reshape(x, …)   →   Reshape(x, [24, 3])
        Range(0, 1000, 1)                         →   a weight

    Only nodes with constant inputs are folded. Arithmetic is limited to integers; floats are only
    moved, compared and cast. Nodes that depend on a frame's values stay, so guards on data (Clip,
    Max, an epsilon, a Where) are never removed. Tables of more than 16,777,216 elements stay, too.
    """

    name = "fold-shapes"

    def rewrite(self, model: ir.Model) -> None:
        """Fold arithmetic on shapes and infer shapes, alternately, until nothing changes."""
        while self._fold_shapes_once(model):
            infer_shapes(model)

    def _fold_shapes_once(self, model: ir.Model) -> bool:
        before = len(self.changed)
        self.refusals.clear()
        for node in list(every_node(model)):
            if len(node.outputs) != 1 or node.outputs[0].is_graph_output():
                continue
            folded_value = self._value_of(node)
            if folded_value is not None:
                self.note(node)
                _replace(node, folded_value)
        return len(self.changed) > before

    def _value_of(self, node: ir.Node) -> np.ndarray | None:
        if node.domain not in MAIN_DOMAIN or is_op(node, "Constant"):
            return None
        if is_op(node, "Shape", "Size"):
            return _known_shape_of_input(node)
        part = _selected_dimensions(node)
        if part is not None:
            return part
        inputs = [constant_of(value, _MAX_FOLDED_SIZE) for value in node.inputs]
        known = [
            value is None or array is not None
            for value, array in zip(node.inputs, inputs, strict=True)
        ]
        if not inputs or not all(known):
            return None
        size = _size_of_table(node, inputs)
        if size > _MAX_SIZE:
            self.refuse(node, f"it would have {size} elements, expected {_MAX_SIZE} at most")
            return None
        result = evaluate(node, inputs)
        largest = _MAX_SIZE if is_op(node, *_TABLE_OPERATORS) else _MAX_FOLDED_SIZE
        return result if result is not None and result.size <= largest else None


def _known_shape_of_input(node: ir.Node) -> np.ndarray | None:
    value = node.inputs[0]
    if is_op(node, "Size"):
        dims = fixed_shape(value)
        return None if dims is None else np.asarray(np.prod(dims, dtype=np.int64))
    axes = _shape_axes(node)
    if axes is None or not all(isinstance(dim, int) for dim in axes):
        return None
    return np.array(axes, np.int64)


def _shape_axes(node: ir.Node) -> list[int | ir.SymbolicDim] | None:
    """Return the sizes (or symbolic names) of the axes that a Shape node returns."""
    value = node.inputs[0]
    if value is None or value.shape is None:
        return None
    end = node.attributes.get("end")
    start = int_attribute(node, "start", 0)
    return list(value.shape)[start : None if end is None else end.as_int()]


def _selected_dimensions(node: ir.Node) -> np.ndarray | None:
    """Return the part of a shape that Gather or Slice selects, if all its sizes are known."""
    source = node.inputs[0] if node.inputs else None
    producer_node = source.producer() if source is not None else None
    if producer_node is None or not (
        is_op(producer_node, "Shape") and is_op(node, "Gather", "Slice")
    ):
        return None
    axes = _shape_axes(producer_node)
    arguments = [constant_of(value, _MAX_FOLDED_SIZE) for value in node.inputs[1:]]
    if axes is None or any(array is None for array in arguments):
        return None
    sizes = np.array([dim if isinstance(dim, int) else -1 for dim in axes], np.int64)
    part = evaluate(node, [sizes, *arguments])
    return part if part is not None and (part >= 0).all() else None


def _size_of_table(node: ir.Node, inputs: list[np.ndarray | None]) -> int:
    """Return how many elements the result of a ConstantOfShape, Expand or Range will have."""
    numbers = [0.0 if array is None else array.reshape(-1) for array in inputs]
    if is_op(node, "ConstantOfShape", "Expand"):
        return int(np.prod(np.maximum(numbers[-1], 0), dtype=np.float64))
    if is_op(node, "Range"):
        start, limit, step = (float(np.ravel(number)[0]) for number in numbers)
        return int(max(0.0, (limit - start) / step)) if step else 0
    return 0


def _replace(node: ir.Node, folded_value: np.ndarray) -> None:
    graph, old = node.graph, node.outputs[0]
    assert isinstance(graph, ir.Graph)
    replace_value(old, weight(graph, f"{old.name}_folded", np.array(folded_value, order="C")))
    graph.remove(node, safe=True)
