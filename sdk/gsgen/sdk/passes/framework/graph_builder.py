"""What passes build graphs from: weights, and nodes whose results have a type."""

__all__ = [
    "InsertionPoint",
    "append_output",
    "free_name",
    "known_array",
    "new_node",
    "remake",
    "weight",
]

from collections.abc import Sequence

import numpy as np
import onnx_ir as ir

Dims = Sequence[int | ir.SymbolicDim | None] | ir.Shape


def weight(graph: ir.Graph, name: str, array: np.ndarray) -> ir.Value:
    """Add ``array`` to ``graph`` as a weight, called ``name`` or, if that is taken, a like name."""
    name = free_name(graph, name)
    tensor = ir.tensor(array, name=name)
    value = ir.Value(
        name=name,
        const_value=tensor,
        type=ir.TensorType(tensor.dtype),
        shape=ir.Shape(array.shape),
    )
    graph.register_initializer(value)
    return value


def free_name(graph: ir.Graph, name: str) -> str:
    """Return ``name`` with as many underscores behind it as make it new to the graph.

    Subgraphs are not asked, which would take long: what they call alike is renamed at the end.
    """
    values = [*graph.inputs, *graph.initializers.values()]
    values += [value for node in graph for value in node.outputs]
    taken = {value.name for value in values}
    while name in taken:
        name += "_"
    return name


def new_node(
    op: str,
    inputs: Sequence[ir.Value | None],
    name: str,
    *,
    dtype: ir.DataType | None = None,
    shape: Dims | None = None,
    **attributes: int | float | str | Sequence[int],
) -> ir.Node:
    """Return a node of the ONNX domain with one result, called ``name`` like the node."""
    node = ir.node(op, inputs, attributes=attributes, name=name)
    (made,) = node.outputs
    made.name = f"{name}_result"
    if dtype is not None:
        made.type = ir.TensorType(dtype)
    if shape is not None:
        made.shape = ir.Shape(list(shape))
    return node


def append_output(graph: ir.Graph, old: ir.Value, nodes: Sequence[ir.Node]) -> None:
    """Let the last of ``nodes`` make the graph output that ``old`` was, under the same name."""
    name = old.name
    old.name = free_name(graph, f"{name}_before_{nodes[-1].name}")
    graph.extend(nodes)
    made = nodes[-1].outputs[0]
    made.name = name
    for index, value in enumerate(graph.outputs):
        if value is old:
            graph.outputs[index] = made


class InsertionPoint:
    """Writes nodes in front of another one, named after it.

    Results get the dtype of their first input unless one is given; shapes are inferred afterwards
    by the pipeline.
    """

    def __init__(self, node: ir.Node) -> None:
        graph = node.graph
        assert isinstance(graph, ir.Graph)
        self.node, self.graph = node, graph
        self._stem = node.name or node.outputs[0].name or node.op_type
        self._count = 0

    def op(
        self,
        kind: str,
        *inputs: ir.Value | None,
        dtype: ir.DataType | None = None,
        shape: Dims | None = None,
        **attributes: int | float | str | Sequence[int],
    ) -> ir.Value:
        """Insert a node of the ONNX domain with one result, and return the result."""
        known = (value.dtype for value in inputs if value is not None)
        kind_of = dtype if dtype is not None else next(known, None)
        name = self._next(kind)
        made = new_node(kind, inputs, name, dtype=kind_of, shape=shape, **attributes)
        self.graph.insert_before(self.node, made)
        return made.outputs[0]

    def ops(
        self,
        kind: str,
        count: int,
        *inputs: ir.Value | None,
        **attributes: int | float | str | Sequence[int],
    ) -> list[ir.Value]:
        """Insert a node with ``count`` results of the dtype of its first input."""
        name = self._next(kind)
        made = ir.node(kind, inputs, attributes=attributes, name=name, num_outputs=count)
        for index, value in enumerate(made.outputs):
            value.name = f"{name}_result_{index}"
            value.type = inputs[0].type if inputs[0] is not None else None
        self.graph.insert_before(self.node, made)
        return list(made.outputs)

    def constant(self, array: np.ndarray, name: str = "constant") -> ir.Value:
        """Add a weight."""
        return weight(self.graph, self._next(name), np.asarray(array))

    def whole(self, *numbers: int) -> ir.Value:
        """Add a weight of int64 [n]: axes, shapes, starts."""
        return self.constant(np.array(numbers, np.int64), "numbers")

    def replace(self, *values: ir.Value) -> None:
        """Remove the node; ``values`` take the places and names of what it returned.

        What stood before the node already (an input of the graph, say) is no output of its own:
        there, Identity comes in between.
        """
        for old, made in zip(self.node.outputs, values, strict=True):
            producer = made.producer()
            fresh = producer is not None and producer.graph is self.graph
            if old.is_graph_output() and (not fresh or made.is_graph_output()):
                made = self.op("Identity", made, shape=made.shape)
            remake(old, made)
        self.graph.remove(self.node, safe=True)

    def _next(self, kind: str) -> str:
        self._count += 1
        return f"{self._stem}_{self._count}_{kind}"


def remake(old: ir.Value, made: ir.Value) -> None:
    """Let ``made`` stand wherever ``old`` did, as a graph output under the same name, too."""
    name, output = old.name, old.is_graph_output()
    if made.type is None or output:
        made.type = old.type
    if made.shape is None or output:
        made.shape = old.shape
    ir.convenience.replace_all_uses_with(old, made, replace_graph_outputs=True)
    if output:
        graph = made.graph
        assert isinstance(graph, ir.Graph)
        old.name = free_name(graph, f"{name}_replaced")
        made.name = name


def known_array(value: ir.Value | None) -> np.ndarray | None:
    """Return the numbers of a weight or of a Constant; None where they are not known."""
    if value is None:
        return None
    if value.is_graph_input():  # a weight that may be fed anew
        return None
    tensor = ir.convenience.get_const_tensor(value)
    return None if tensor is None else tensor.numpy()
