"""Outputs that survive the replay of a captured graph."""

__all__ = ["EndOutputsOnCompute"]

import numpy as np
import onnx_ir as ir

from gsgen.contract.model.buffer_copies import is_copy
from gsgen.sdk.passes.framework.base import Rewrite
from gsgen.sdk.passes.framework.graph_builder import free_name, new_node, weight


class EndOutputsOnCompute(Rewrite):
    """End every output on an operator that computes: Mul by one.

    Graph capture records kernels, not buffer copies, so an output that Reshape or its kin makes,
    or an operator with nothing to do, repeats the first frame for ever. An output that is a weight loses its name in some runtimes::

        Reshape → color_sh        →   Reshape → Mul(1) → color_sh
        weight (color_sh)         →   weight → Mul(1) → color_sh

    Multiplying by one changes no bit of a number. A mask, which cannot be multiplied, ends on And(true).
    """

    name = "end-on-compute"

    def rewrite(self, model: ir.Model) -> None:
        """Mend every output that needs it."""
        seen: set[ir.Value] = set()
        for index, value in enumerate(model.graph.outputs):
            if value.is_graph_input():
                continue  # two tensors of one name cannot be: the output would need another
            producer = value.producer()
            if producer is None or _copies(producer) or value in seen:
                self.note(value)
                _end_on_mul(model.graph, index, value)
            seen.add(value)


def _copies(node: ir.Node) -> bool:
    if node.domain not in ("", "ai.onnx"):
        return False
    idle = node.attributes.get_int("noop_with_empty_axes", 0) == 1
    named = "axes" in node.attributes and bool(node.attributes["axes"].as_ints())
    axes = node.inputs[1] if len(node.inputs) > 1 else None
    empty = axes is None or (axes.shape is not None and 0 in axes.shape.dims)
    return is_copy(
        node.op_type, len(node.inputs), keeps_all_axes=idle and empty and not named
    )


def _end_on_mul(graph: ir.Graph, index: int, value: ir.Value) -> None:
    name, kind = value.name, value.dtype
    if kind is None:
        raise ValueError(f"output {name!r} has no dtype")
    value.name = free_name(graph, f"{name}_uncopied")
    one = weight(graph, f"{name}_one", np.ones((), kind.numpy()))
    computing = "And" if kind == ir.DataType.BOOL else "Mul"
    node = new_node(computing, [value, one], f"{name}_end")
    made = node.outputs[0]
    made.name, made.type, made.shape = name, value.type, value.shape
    graph.append(node)
    graph.outputs[index] = made
