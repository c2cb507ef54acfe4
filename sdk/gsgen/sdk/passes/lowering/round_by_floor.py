"""Rewrites the operator Round by Floor, because WebGPU has no kernel for Round."""

__all__ = ["LowerRoundToFloor"]

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import new_node, weight
from gsgen.sdk.passes.framework.value_facts import required


class LowerRoundToFloor(NodeRewrite):
    """Replace every Round by Floor and comparisons.

    ONNX Runtime has no WebGPU kernel for Round in any version: the node stays on the CPU, and
    the graph is not captured. As in Round, a tie is rounded to the even neighbour::

        Round(x)   →   f + (1 if x - f > ½ else f mod 2 if x - f = ½ else 0), where f = Floor(x)
    """

    name = "round-by-floor"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node is a Round of a known dtype."""
        known = node.inputs[:1] and node.inputs[0] is not None and node.inputs[0].dtype
        return is_op(node, "Round") and bool(known)

    def replace(self, node: ir.Node) -> None:
        """Replace a Round by Floor and comparisons."""
        graph, x, old = node.graph, required(node.inputs[0]), node.outputs[0]
        assert isinstance(graph, ir.Graph)
        dtype = required(x.dtype)
        zero, half, unit = (
            weight(graph, f"{node.name}_{name}", np.asarray(value, dtype.numpy()))
            for name, value in (("zero", 0), ("half", 0.5), ("one", 1))
        )

        def append(op: str, *inputs: ir.Value) -> ir.Value:
            operator_node = new_node(op, inputs, f"{node.name}_{len(nodes)}_{op}")
            tests = op in ("Equal", "Greater")
            operator_node.outputs[0].type = ir.TensorType(ir.DataType.BOOL if tests else dtype)
            operator_node.outputs[0].shape = x.shape
            nodes.append(operator_node)
            return operator_node.outputs[0]

        nodes: list[ir.Node] = []
        floor_value = append("Floor", x)
        fraction = append("Sub", x, floor_value)
        pairs = append("Floor", append("Mul", floor_value, half))
        is_odd = append("Sub", floor_value, append("Add", pairs, pairs))
        tie_increment = append("Where", append("Equal", fraction, half), is_odd, zero)
        rounded_fraction = append("Where", append("Greater", fraction, half), unit, tie_increment)
        result, name = append("Add", floor_value, rounded_fraction), old.name
        graph.insert_before(node, nodes)
        ir.convenience.replace_all_uses_with(old, result, replace_graph_outputs=True)
        graph.remove(node, safe=True)
        result.name = name
