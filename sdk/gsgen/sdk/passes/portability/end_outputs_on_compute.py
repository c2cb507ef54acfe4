"""Appends a computing operator to outputs that graph capture would miss (copies, weights)."""

__all__ = ["EndOutputsOnCompute"]

import numpy as np
import onnx_ir as ir

from gsgen.contract.model.provider_placement import is_copy
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.sdk.passes.framework.base import Rewrite
from gsgen.sdk.passes.framework.graph_builder import new_node, unused_name, weight


class EndOutputsOnCompute(Rewrite):
    """Append Mul by one to every output that is only a buffer copy, or a weight.

    Graph capture records kernels, not buffer copies. An output of Reshape, of a similar operator
    or of one that computes nothing repeats the first frame forever. An output that is a weight
    loses its name in some runtimes::

        1  Reshape → color_sh   →   Reshape → Mul(1) → color_sh
        2  weight (color_sh)    →   weight → Mul(1) → color_sh

    Multiplying by one changes no bit of a number. A boolean output ends on And(true) instead.
    """

    name = "end-on-compute"

    def rewrite(self, model: ir.Model) -> None:
        """Append Mul or And to every graph output that is a buffer copy or a weight."""
        visited_values: set[ir.Value] = set()
        for index, value in enumerate(model.graph.outputs):
            if value.is_graph_input():
                continue  # input and output share a name, which a new output could not have
            if not isinstance(value.type, ir.TensorType) or value.dtype == ir.DataType.STRING:
                continue  # sequences, optionals and strings have no arithmetic
            producer = value.producer()
            # Case 1: a copy, or a second output of the same value. Case 2: a weight.
            if producer is None or _does_only_copy(producer) or value in visited_values:
                self.note(value)
                _append_mul_by_one(model.graph, index, value)
            visited_values.add(value)


def _does_only_copy(node: ir.Node) -> bool:
    if node.domain not in MAIN_DOMAIN:
        return False
    is_noop_with_empty_axes = node.attributes.get_int("noop_with_empty_axes", 0) == 1
    has_axes_attribute = "axes" in node.attributes and bool(node.attributes["axes"].as_ints())
    axes = node.inputs[1] if len(node.inputs) > 1 else None
    is_empty = axes is None or (axes.shape is not None and 0 in axes.shape.dims)
    return is_copy(
        node.op_type,
        len(node.inputs),
        keeps_all_axes=is_noop_with_empty_axes and is_empty and not has_axes_attribute,
    )


def _append_mul_by_one(graph: ir.Graph, index: int, value: ir.Value) -> None:
    name, kind = value.name, value.dtype
    assert kind is not None  # the caller skips outputs without a type
    value.name = unused_name(graph, f"{name}_uncopied")
    unit = weight(graph, f"{name}_one", np.ones((), kind.numpy()))
    operator = "And" if kind == ir.DataType.BOOL else "Mul"
    node = new_node(operator, [value, unit], f"{name}_end")
    result = node.outputs[0]
    result.name, result.type, result.shape = name, value.type, value.shape
    graph.append(node)
    graph.outputs[index] = result
