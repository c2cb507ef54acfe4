"""Nodes that are drafted beside a graph, and join it all together or not at all."""

__all__ = ["Detached"]

from collections.abc import Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.graph_builder import Dims, new_node, weight


class Detached:
    """Drafts nodes; the graph does not know of them before :meth:`join`.

    Each node will stand before the node that was :attr:`anchor` when it was drafted, or at the end
    of the graph where that was None.
    """

    def __init__(self, stem: str) -> None:
        self.anchor: ir.Node | None = None
        self._stem = stem
        self._nodes: list[tuple[ir.Node | None, ir.Node]] = []
        self._weights: list[ir.Value] = []

    def op(
        self,
        kind: str,
        *inputs: ir.Value | None,
        dtype: ir.DataType | None = None,
        shape: Dims | None = None,
        **attributes: int | float | str | Sequence[int],
    ) -> ir.Value:
        """Draft a node of the ONNX domain with one result, and return the result."""
        known = next(
            (v.dtype for v in inputs if v is not None and v.dtype is not None), None
        )
        name = f"{self._stem}_{len(self._nodes)}_{kind}"
        node = new_node(
            kind,
            inputs,
            name,
            dtype=known if dtype is None else dtype,
            shape=shape,
            **attributes,
        )
        self._nodes.append((self.anchor, node))
        return node.outputs[0]

    def like(self, node: ir.Node, inputs: Sequence[ir.Value | None]) -> list[ir.Value]:
        """Draft a copy of ``node`` that reads ``inputs``; results have its dtypes and no shapes."""
        name = f"{self._stem}_{len(self._nodes)}_{node.op_type}"
        copy = ir.Node(
            node.domain,
            node.op_type,
            list(inputs),
            [*node.attributes.values()],
            num_outputs=len(node.outputs),
            name=name,
        )
        for place, (made, old) in enumerate(zip(copy.outputs, node.outputs, strict=True)):
            made.name, made.type = f"{name}_{place}", old.type
        self._nodes.append((self.anchor, copy))
        return list(copy.outputs)

    def constant(
        self, array: object, dtype: type[np.generic] | np.dtype[np.generic]
    ) -> ir.Value:
        """Draft a weight."""
        whole = np.asarray(array, dtype)
        tensor = ir.tensor(whole)
        made = ir.Value(
            name=f"{self._stem}_weight_{len(self._weights)}",
            const_value=tensor,
            type=ir.TensorType(tensor.dtype),
            shape=ir.Shape(whole.shape),
        )
        self._weights.append(made)
        return made

    def join(self, graph: ir.Graph) -> None:
        """Put all that was drafted and is read by something into ``graph``."""
        for value in self._weights:
            array = value.const_value
            assert array is not None
            if value.uses():
                stands = weight(graph, value.name or self._stem, array.numpy())
                ir.convenience.replace_all_uses_with(value, stands)
        for anchor, node in self._nodes:
            if anchor is None:
                graph.append(node)
            else:
                graph.insert_before(anchor, node)

    def discard(self) -> None:
        """Let the graph's values forget that drafted nodes were to read them."""
        for _, node in self._nodes:
            for place in range(len(node.inputs)):
                node.replace_input_with(place, None)
        self._nodes.clear()
        self._weights.clear()
