"""Finds connected nodes of a graph that work on tensors with the same number of rows."""

__all__ = ["RowGroup", "row_groups"]

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import prod

import onnx_ir as ir

from gsgen.sdk.passes.framework.value_facts import fixed_shape

_MAX_ROW_WIDTH = 16


@dataclass
class RowGroup:
    """Connected graph nodes that work on tensors with the same number of rows."""

    rows: int
    nodes: list[ir.Node] = field(default_factory=list)


def row_groups(
    graph: ir.Graph, sizes: range, is_member: Callable[[ir.Node, int], bool]
) -> Iterator[RowGroup]:
    """Yield groups of connected, input-dependent nodes on long, narrow tensors, in graph order.

    Args:
        graph: The graph.
        sizes: The numbers of rows to look for.
        is_member: Whether a node on tensors of so many rows belongs to a group.
    """
    varying_values = {value for value in graph.inputs if value.name not in graph.initializers}
    group_of_value: dict[ir.Value, RowGroup] = {}
    groups: list[RowGroup] = []
    for node in graph:
        if not varying_values.intersection(value for value in node.inputs if value is not None):
            continue
        varying_values.update(node.outputs)
        rows = _rows(node, sizes, is_member)
        if rows is None:
            continue
        neighbours = {
            id(group_of_value[v]): group_of_value[v]
            for v in node.inputs
            if v in group_of_value and group_of_value[v].rows == rows
        }
        merged_group = RowGroup(rows)
        for neighbour in neighbours.values():
            merged_group.nodes += neighbour.nodes
            groups.remove(neighbour)
        merged_group.nodes.append(node)
        groups.append(merged_group)
        group_of_value |= {
            value: merged_group for member in merged_group.nodes for value in member.outputs
        }
    order = {node: index for index, node in enumerate(graph)}
    for group in groups:
        group.nodes.sort(key=order.__getitem__)
        yield group


def _rows(node: ir.Node, sizes: range, is_member: Callable[[ir.Node, int], bool]) -> int | None:
    """Return the number of rows of a node's results if it belongs to a group, else None."""
    shapes = [fixed_shape(value) for value in node.outputs]
    rows = {shape[0] if shape else 0 for shape in shapes}
    if None in shapes or len(rows) != 1:
        return None
    (count,) = rows
    are_shapes_narrow = all(shape and prod(shape[1:]) <= _MAX_ROW_WIDTH for shape in shapes)
    return count if count in sizes and are_shapes_narrow and is_member(node, count) else None
