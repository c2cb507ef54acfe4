"""The part of a graph that no input reaches: runtimes compute it once, when a model is loaded."""

__all__ = ["ConstantPart", "constant_nodes", "partition_constants"]

from collections.abc import Iterator
from dataclasses import dataclass

import onnx_ir as ir

_BODIES = (ir.AttributeType.GRAPH, ir.AttributeType.GRAPHS)


def constant_nodes(graph: ir.Graph) -> list[ir.Node]:
    """Return the nodes that follow from weights alone, in the order of the graph.

    Nodes with bodies do not count, as a body may read what it is not given, nor do nodes whose
    every run differs.
    """
    found: list[ir.Node] = []
    known: set[ir.Value] = set()
    for node in graph:
        given = [value for value in node.inputs if value is not None]
        bodies = any(one.type in _BODIES for one in node.attributes.values())
        if bodies or "Random" in node.op_type or not given:
            continue
        if all(value in known or _is_weight(value) for value in given):
            found.append(node)
            known.update(node.outputs)
    return found


def _is_weight(value: ir.Value) -> bool:
    return value.is_initializer() and not value.is_graph_input()


@dataclass(frozen=True, slots=True)
class ConstantPart:
    """A model in two.

    Attributes:
        once: What follows from weights, without inputs; None where nothing does.
        rest: The model, whose further inputs are the outputs of ``once``.
        between: Names of these.
    """

    once: ir.Model | None
    rest: ir.Model
    between: tuple[str, ...]


def partition_constants(model: ir.Model) -> ConstantPart:
    """Cut copies of ``model`` apart; it is left as it is."""
    rest = model.clone()
    nodes = constant_nodes(rest.graph)
    if not nodes:
        return ConstantPart(None, rest, ())
    once = model.clone()
    between = tuple(value.name or "" for value in _read_outside(rest.graph, nodes))
    _keep_nodes(once.graph, constant_nodes(once.graph), between)
    for value in list(_read_outside(rest.graph, nodes)):
        _feed(rest.graph, value)
    rest.graph.remove(nodes, safe=True)
    for one in (once, rest):
        _drop_weights(one.graph)
    return ConstantPart(once, rest, between)


def _read_outside(graph: ir.Graph, nodes: list[ir.Node]) -> Iterator[ir.Value]:
    inside = set(nodes)
    for node in nodes:
        for value in node.outputs:
            outside = any(use.node not in inside for use in value.uses())
            if outside or value.is_graph_output():
                yield value


def _keep_nodes(graph: ir.Graph, nodes: list[ir.Node], outputs: tuple[str, ...]) -> None:
    kept, wanted = set(nodes), set(outputs)
    made = {v.name: v for node in nodes for v in node.outputs if v.name in wanted}
    graph.inputs.clear()
    graph.outputs.clear()
    graph.outputs.extend(made[name] for name in outputs)
    graph.remove([node for node in graph if node not in kept], safe=True)


def _feed(graph: ir.Graph, value: ir.Value) -> None:
    """Let an input take the place of ``value``, under its name."""
    given = ir.Value(name=value.name, type=value.type, shape=value.shape)
    value.name = f"{value.name}_computed"
    graph.inputs.append(given)
    for use in list(value.uses()):
        use.node.replace_input_with(use.idx, given)
    for index, output in enumerate(list(graph.outputs)):
        if output is value:
            graph.outputs[index] = given


def _drop_weights(graph: ir.Graph) -> None:
    for name, value in list(graph.initializers.items()):
        if not value.uses() and not value.is_graph_output():
            del graph.initializers[name]
