"""Outputs that survive the replay of a captured graph."""

__all__ = ["EndOutputsOnCompute"]

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.base import Rewrite
from gsgen.sdk.passes.building import new_node, weight

_VIEWS = frozenset({"Flatten", "Identity", "Reshape", "Squeeze", "Unsqueeze"})


class EndOutputsOnCompute(Rewrite):
    """End every output on an operator that computes: Mul by one.

    Graph capture records kernels, not buffer copies, so an output that Reshape or its kin makes
    repeats the first frame for ever. An output that is a weight loses its name in some runtimes::

        Reshape → color_sh        →   Reshape → Mul(1) → color_sh
        weight (color_sh)         →   weight → Mul(1) → color_sh

    Multiplying by one changes no bit of a number.
    """

    name = "end-on-compute"

    def rewrite(self, model: ir.Model) -> None:
        """Mend every output that needs it."""
        seen: set[ir.Value] = set()
        for index, value in enumerate(model.graph.outputs):
            producer = value.producer()
            if producer is None or producer.op_type in _VIEWS or value in seen:
                self.note(value)
                _end_on_mul(model.graph, index, value)
            seen.add(value)


def _end_on_mul(graph: ir.Graph, index: int, value: ir.Value) -> None:
    name, kind = value.name, value.dtype
    if kind is None:
        raise ValueError(f"output {name!r} has no dtype")
    value.name = f"{name}_uncopied"
    one = weight(graph, f"{name}_one", np.ones((), kind.numpy()))
    node = new_node("Mul", [value, one], f"{name}_end")
    made = node.outputs[0]
    made.name, made.type, made.shape = name, value.type, value.shape
    graph.append(node)
    graph.outputs[index] = made
