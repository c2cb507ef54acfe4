"""What passes build graphs from: weights, and nodes whose results have a type."""

__all__ = ["append_output", "new_node", "weight"]

from collections.abc import Sequence

import numpy as np
import onnx_ir as ir


def weight(graph: ir.Graph, name: str, array: np.ndarray) -> ir.Value:
    """Add ``array`` to ``graph`` as a weight, called ``name`` or, if that is taken, a like name."""
    name = _free(graph, name)
    tensor = ir.tensor(array, name=name)
    value = ir.Value(
        name=name,
        const_value=tensor,
        type=ir.TensorType(tensor.dtype),
        shape=ir.Shape(array.shape),
    )
    graph.register_initializer(value)
    return value


def _free(graph: ir.Graph, name: str) -> str:
    """Return ``name`` with as many underscores behind it as make it new to the graph."""
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
    shape: Sequence[int | ir.SymbolicDim | None] | None = None,
    **attributes: int | Sequence[int],
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
    old.name = f"{name}_before_{nodes[-1].name}"
    graph.extend(nodes)
    made = nodes[-1].outputs[0]
    made.name = name
    for index, value in enumerate(graph.outputs):
        if value is old:
            graph.outputs[index] = made
