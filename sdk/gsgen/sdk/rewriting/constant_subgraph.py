"""The constant subgraph: graph nodes that depend on weights only, which runtimes compute once."""

__all__ = ["PartitionedModel", "constant_nodes", "partition_constants"]

from collections.abc import Iterator
from dataclasses import dataclass

import onnx_ir as ir

_GRAPH_ATTRIBUTE_TYPES = (ir.AttributeType.GRAPH, ir.AttributeType.GRAPHS)


def constant_nodes(graph: ir.Graph) -> list[ir.Node]:
    """Return the graph nodes that depend on weights only, in graph order.

    Nodes with bodies are excluded, since a body may read values of the outer graph, and so are
    random operators, whose every run differs.
    """
    constants: list[ir.Node] = []
    known: set[ir.Value] = set()
    for node in graph:
        node_inputs = [value for value in node.inputs if value is not None]
        bodies = any(
            attribute.type in _GRAPH_ATTRIBUTE_TYPES for attribute in node.attributes.values()
        )
        if bodies or "Random" in node.op_type or not node_inputs:
            continue
        if all(value in known or _is_weight(value) for value in node_inputs):
            constants.append(node)
            known.update(node.outputs)
    return constants


def _is_weight(value: ir.Value) -> bool:
    return value.is_initializer() and not value.is_graph_input()


@dataclass(frozen=True, slots=True)
class PartitionedModel:
    """A model in two parts: the constant subgraph, and the nodes that run every frame."""

    constant: ir.Model | None  # the constant subgraph, without inputs; None if it is empty
    per_frame: ir.Model  # the other nodes; the outputs of ``constant`` are further inputs
    boundary: tuple[str, ...]  # names of these inputs


def partition_constants(model: ir.Model) -> PartitionedModel:
    """Split a copy of a model into its constant subgraph and the nodes that run every frame."""
    per_frame = model.clone()
    nodes = constant_nodes(per_frame.graph)
    if not nodes:
        return PartitionedModel(None, per_frame, ())
    constant = model.clone()
    boundary = tuple(value.name or "" for value in _values_read_outside(per_frame.graph, nodes))
    _keep_nodes(constant.graph, constant_nodes(constant.graph), boundary)
    for value in list(_values_read_outside(per_frame.graph, nodes)):
        _make_input(per_frame.graph, value)
    per_frame.graph.remove(nodes, safe=True)
    for part in (constant, per_frame):
        _drop_weights(part.graph)
    return PartitionedModel(constant, per_frame, boundary)


def _values_read_outside(graph: ir.Graph, nodes: list[ir.Node]) -> Iterator[ir.Value]:
    inner_nodes = set(nodes)
    for node in nodes:
        for value in node.outputs:
            is_read_outside = any(use.node not in inner_nodes for use in value.uses())
            if is_read_outside or value.is_graph_output():
                yield value


def _keep_nodes(graph: ir.Graph, nodes: list[ir.Node], outputs: tuple[str, ...]) -> None:
    retained, names = set(nodes), set(outputs)
    values_by_name = {v.name: v for node in nodes for v in node.outputs if v.name in names}
    graph.inputs.clear()
    graph.outputs.clear()
    graph.outputs.extend(values_by_name[name] for name in outputs)
    graph.remove([node for node in graph if node not in retained], safe=True)


def _make_input(graph: ir.Graph, value: ir.Value) -> None:
    """Turn a value inside a graph into a graph input of the same name."""
    graph_input = ir.Value(name=value.name, type=value.type, shape=value.shape)
    value.name = f"{value.name}_computed"
    graph.inputs.append(graph_input)
    for use in list(value.uses()):
        use.node.replace_input_with(use.idx, graph_input)
    for index, output in enumerate(list(graph.outputs)):
        if output is value:
            graph.outputs[index] = graph_input


def _drop_weights(graph: ir.Graph) -> None:
    for name, value in list(graph.initializers.items()):
        if not value.uses() and not value.is_graph_output():
            del graph.initializers[name]
