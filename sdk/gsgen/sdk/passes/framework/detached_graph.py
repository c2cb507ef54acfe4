"""Creates ONNX nodes outside of a graph, to be added all together or discarded."""

__all__ = ["DetachedGraph"]

from collections.abc import Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.graph_builder import Dims, new_node, weight


class DetachedGraph:
    """Creates ONNX nodes and weights outside of a graph; :meth:`join` adds all of them to it.

    Each node is inserted before the node that was :attr:`anchor` when it was drafted, or at the
    end of the graph if that was None.
    """

    def __init__(self, stem: str) -> None:
        self.anchor: ir.Node | None = None
        self._name_stem = stem
        self._nodes: list[tuple[ir.Node | None, ir.Node]] = []
        self._weights: list[ir.Value] = []

    def op(
        self,
        kind: str,
        *inputs: ir.Value | None,
        dtype: ir.DataType | None = None,
        shape: Dims | None = None,
        **attributes: int | float | str | Sequence[int],
    ) -> ir.Value:
        """Create a standard ONNX node with one output outside of a graph; return the output."""
        known = next((v.dtype for v in inputs if v is not None and v.dtype is not None), None)
        name = f"{self._name_stem}_{len(self._nodes)}_{kind}"
        node = new_node(
            kind, inputs, name, dtype=known if dtype is None else dtype, shape=shape, **attributes
        )
        self._nodes.append((self.anchor, node))
        return node.outputs[0]

    def like(self, node: ir.Node, inputs: Sequence[ir.Value | None]) -> list[ir.Value]:
        """Create a copy of a node with other inputs, outside of the graph."""
        name = f"{self._name_stem}_{len(self._nodes)}_{node.op_type}"
        copy = ir.Node(
            node.domain,
            node.op_type,
            list(inputs),
            [*node.attributes.values()],
            num_outputs=len(node.outputs),
            name=name,
        )
        for index, (result, old) in enumerate(zip(copy.outputs, node.outputs, strict=True)):
            result.name, result.type = f"{name}_{index}", old.type
        self._nodes.append((self.anchor, copy))
        return list(copy.outputs)

    def constant(self, array: object, dtype: type[np.generic] | np.dtype[np.generic]) -> ir.Value:
        """Create a weight from an array, outside of the graph."""
        values = np.asarray(array, dtype)
        tensor = ir.tensor(values)
        value = ir.Value(
            name=f"{self._name_stem}_weight_{len(self._weights)}",
            const_value=tensor,
            type=ir.TensorType(tensor.dtype),
            shape=ir.Shape(values.shape),
        )
        self._weights.append(value)
        return value

    def join(self, graph: ir.Graph) -> None:
        """Add all created nodes to a graph, and the created weights that they read."""
        for value in self._weights:
            array = value.const_value
            assert array is not None
            if value.uses():
                initializer = weight(graph, value.name or self._name_stem, array.numpy())
                ir.convenience.replace_all_uses_with(value, initializer)
        for anchor, node in self._nodes:
            if anchor is None:
                graph.append(node)
            else:
                graph.insert_before(anchor, node)

    def discard(self) -> None:
        """Discard all created nodes that were not added to a graph."""
        for _, node in self._nodes:
            for index in range(len(node.inputs)):
                node.replace_input_with(index, None)
        self._nodes.clear()
        self._weights.clear()
