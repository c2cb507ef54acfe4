"""Rounding that a GPU can do."""

__all__ = ["RoundByFloor"]

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite
from gsgen.sdk.passes.framework.graph_builder import new_node, weight


class RoundByFloor(NodeRewrite):
    """Write every Round with Floor.

    ONNX Runtime has no WebGPU kernel for Round in any version: the node stays on the CPU, and
    the graph is not captured. A tie goes to the even neighbour, as it does in Round::

        Round(x)   →   f + (1 if x - f > ½ else f mod 2 if x - f = ½ else 0), where f = Floor(x)
    """

    name = "round-by-floor"

    def matches(self, node: ir.Node) -> bool:
        """Say whether it is a Round of a known dtype."""
        return _rounds(node)

    def replace(self, node: ir.Node) -> None:
        """Write it with Floor."""
        _rewrite(node)


def _rounds(node: ir.Node) -> bool:
    known = node.inputs[:1] and node.inputs[0] is not None and node.inputs[0].dtype
    return node.op_type == "Round" and node.domain in ("", "ai.onnx") and bool(known)


def _rewrite(node: ir.Node) -> None:
    graph, x, old = node.graph, node.inputs[0], node.outputs[0]
    assert isinstance(graph, ir.Graph)
    assert x is not None
    dtype = x.dtype
    assert dtype is not None
    zero, half, one = (
        weight(graph, f"{node.name}_{name}", np.asarray(value, dtype.numpy()))
        for name, value in (("zero", 0), ("half", 0.5), ("one", 1))
    )

    def then(op: str, *inputs: ir.Value) -> ir.Value:
        made = new_node(op, inputs, f"{node.name}_{len(made_nodes)}_{op}")
        tests = op in ("Equal", "Greater")
        made.outputs[0].type = ir.TensorType(ir.DataType.BOOL if tests else dtype)
        made.outputs[0].shape = x.shape
        made_nodes.append(made)
        return made.outputs[0]

    made_nodes: list[ir.Node] = []
    floor = then("Floor", x)
    part = then("Sub", x, floor)
    pairs = then("Floor", then("Mul", floor, half))
    odd = then("Sub", floor, then("Add", pairs, pairs))
    tie = then("Where", then("Equal", part, half), odd, zero)
    up = then("Where", then("Greater", part, half), one, tie)
    made, name = then("Add", floor, up), old.name
    graph.insert_before(node, made_nodes)
    ir.convenience.replace_all_uses_with(old, made, replace_graph_outputs=True)
    graph.remove(node, safe=True)
    made.name = name
