"""Functions that add weights and typed nodes to an ONNX graph, and replace values."""

__all__ = [
    "InsertionPoint",
    "append_output",
    "constant_array",
    "new_node",
    "remembered_names",
    "replace_value",
    "unused_name",
    "weight",
]  # fmt: skip

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import onnx_ir as ir

# Where a graph keeps the names that it uses while a pass runs.
_USED_NAMES_METADATA_KEY = "gsgen used names"

Dims = Sequence[int | ir.SymbolicDim | None] | ir.Shape


def weight(graph: ir.Graph, name: str, array: np.ndarray) -> ir.Value:
    """Add an array to a graph as a named weight, with underscores appended if the name exists."""
    name = unused_name(graph, name)
    tensor = ir.tensor(array, name=name)
    value = ir.Value(
        name=name, const_value=tensor, type=ir.TensorType(tensor.dtype), shape=ir.Shape(array.shape)
    )
    graph.register_initializer(value)
    return value


def unused_name(graph: ir.Graph, name: str) -> str:
    """Return a value name that a graph does not use yet, by appending underscores to a given one.

    Subgraphs are not searched, which would take long: duplicates there are renamed at the end.
    """
    used_names = graph.meta.get(_USED_NAMES_METADATA_KEY) or _names(graph)
    if _USED_NAMES_METADATA_KEY in graph.meta:
        graph.meta[_USED_NAMES_METADATA_KEY] = used_names
    while name in used_names:
        name += "_"
    used_names.add(name)
    return name


@contextmanager
def remembered_names(graph: ir.Graph) -> Iterator[None]:
    """Collect the names that a graph uses once while a pass runs, not for each new weight."""
    graph.meta[_USED_NAMES_METADATA_KEY] = None
    try:
        yield
    finally:
        del graph.meta[_USED_NAMES_METADATA_KEY]


def _names(graph: ir.Graph) -> set[str | None]:
    values = [*graph.inputs, *graph.initializers.values()]
    return {value.name for value in values} | {v.name for node in graph for v in node.outputs}


def new_node(
    op: str,
    inputs: Sequence[ir.Value | None],
    name: str,
    *,
    dtype: ir.DataType | None = None,
    shape: Dims | None = None,
    **attributes: int | float | str | Sequence[int],
) -> ir.Node:
    """Create a standard ONNX node whose output has the name of the node."""
    node = ir.node(op, inputs, attributes=attributes, name=name)
    (result,) = node.outputs
    result.name = name
    if dtype is not None:
        result.type = ir.TensorType(dtype)
    if shape is not None:
        result.shape = ir.Shape(list(shape))
    return node


def append_output(graph: ir.Graph, old_value: ir.Value, nodes: Sequence[ir.Node]) -> None:
    """Append nodes to a graph, the last of which computes an existing graph output."""
    name = old_value.name
    old_value.name = unused_name(graph, f"{name}_before_{nodes[-1].name}")
    graph.extend(nodes)
    new = nodes[-1].outputs[0]
    new.name = name
    for index, value in enumerate(graph.outputs):
        if value is old_value:
            graph.outputs[index] = new


class InsertionPoint:
    """Inserts nodes before a given node, and derives their names from the name of that node.

    Outputs get the dtype of their first input unless one is given; the pipeline infers shapes
    afterwards.
    """

    def __init__(self, node: ir.Node) -> None:
        graph = node.graph
        assert isinstance(graph, ir.Graph)
        self.node, self.graph = node, graph
        self._name_stem = node.name or node.outputs[0].name or node.op_type
        self._count = 0

    def op(
        self,
        kind: str,
        *inputs: ir.Value | None,
        dtype: ir.DataType | None = None,
        shape: Dims | None = None,
        **attributes: int | float | str | Sequence[int],
    ) -> ir.Value:
        """Insert a standard ONNX node with one output into the graph, and return the output."""
        known = (value.dtype for value in inputs if value is not None)
        result_dtype = dtype if dtype is not None else next(known, None)
        name = self._next_name(kind)
        node = new_node(kind, inputs, name, dtype=result_dtype, shape=shape, **attributes)
        self._insert_node(node)
        return node.outputs[0]

    def ops(
        self,
        kind: str,
        count: int,
        *inputs: ir.Value | None,
        **attributes: int | float | str | Sequence[int],
    ) -> list[ir.Value]:
        """Insert a node with several outputs, which have the dtype of the first input."""
        name = self._next_name(kind)
        node = ir.node(kind, inputs, attributes=attributes, name=name, num_outputs=count)
        for index, value in enumerate(node.outputs):
            value.name = f"{name}_{index}"
            value.type = inputs[0].type if inputs[0] is not None else None
        self._insert_node(node)
        return list(node.outputs)

    def constant(self, array: np.ndarray, name: str = "constant") -> ir.Value:
        """Add a weight to the graph, with the numbers of an array."""
        return weight(self.graph, self._next_name(name), np.asarray(array))

    def int64(self, *numbers: int) -> ir.Value:
        """Add an int64 weight [n], such as axes, a shape or starts."""
        return self.constant(np.array(numbers, np.int64), "numbers")

    def replace(self, *values: ir.Value) -> None:
        """Remove a node from the graph; other values replace its outputs under the same names.

        A graph output needs a value of its own. If the value existed before the node (an input
        of the graph, for example), an Identity is inserted.
        """
        for old_value, new in zip(self.node.outputs, values, strict=True):
            producer = new.producer()
            is_new_node = producer is not None and producer.graph is self.graph
            if old_value.is_graph_output() and (not is_new_node or new.is_graph_output()):
                new = self.op("Identity", new, shape=new.shape)
            replace_value(old_value, new)
        self.graph.remove(self.node, safe=True)

    def _next_name(self, kind: str) -> str:
        self._count += 1
        return f"{self._name_stem}_{self._count}_{kind}"

    def _insert_node(self, node: ir.Node) -> None:
        self.graph.insert_before(self.node, node)
        if used_names := self.graph.meta.get(_USED_NAMES_METADATA_KEY):
            used_names.update(value.name for value in node.outputs)


def replace_value(old_value: ir.Value, new: ir.Value) -> None:
    """Replace all uses of a graph value by another value; a graph output keeps its name."""
    name, output = old_value.name, old_value.is_graph_output()
    if new.type is None or output:
        new.type = old_value.type
    if new.shape is None or output:
        new.shape = old_value.shape
    ir.convenience.replace_all_uses_with(old_value, new, replace_graph_outputs=True)
    if output:
        graph = new.graph
        assert isinstance(graph, ir.Graph)
        old_value.name = unused_name(graph, f"{name}_replaced")
        new.name = name


def constant_array(value: ir.Value | None) -> np.ndarray | None:
    """Return the array of a weight or of a Constant node; None for other values."""
    if value is None:
        return None
    if value.is_graph_input():  # a weight that a caller may replace
        return None
    tensor = ir.convenience.get_const_tensor(value)
    return None if tensor is None else tensor.numpy()
