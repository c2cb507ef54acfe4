"""Products of matrices and vectors that every runtime computes right."""

__all__ = ["MultiplyMatrices"]

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, NodeRewrite
from gsgen.sdk.passes.framework.graph_builder import new_node, weight


class MultiplyMatrices(NodeRewrite):
    """Make both operands of every MatMul matrices.

    ONNX Runtime (seen in 1.31) fuses Transpose into MatMul, and computes A v where Aᵀ v was meant
    if v has one axis: the camera centre −Rᵀ t comes out wrong, without any error. And
    onnxruntime-web 1.22 has no kernel for operands of one axis::

        MatMul(A, v)   →   Squeeze(MatMul(A, Unsqueeze(v, 1)), -1)
        MatMul(v, B)   →   Squeeze(MatMul(Unsqueeze(v, 0), B), -2)
    """

    name = "multiply-matrices"
    exactness = ErrorBudget(relative=1e-6)

    def matches(self, node: ir.Node) -> bool:
        """Say whether it is a MatMul with an operand of one axis."""
        return bool(_vector_operands(node))

    def replace(self, node: ir.Node) -> None:
        """Give the vector a second axis."""
        _rewrite(node)


def _vector_operands(node: ir.Node) -> list[int]:
    """Return which inputs of a MatMul are known to have one axis."""
    if node.op_type != "MatMul" or node.domain not in ("", "ai.onnx"):
        return []
    shapes = [value.shape if value is not None else None for value in node.inputs]
    return [
        index for index, shape in enumerate(shapes) if shape is not None and len(shape) == 1
    ]


def _rewrite(node: ir.Node) -> None:
    graph = node.graph
    assert isinstance(graph, ir.Graph)
    vectors, old = _vector_operands(node), node.outputs[0]
    operands = list(node.inputs)
    for index in vectors:
        axis = 0 if index == 0 else 1  # on the left a row, on the right a column
        lifted = _reaxed(
            graph, "Unsqueeze", operands[index], [axis], f"{node.name}_{index}"
        )
        size = _size(operands[index])
        lifted.outputs[0].shape = ir.Shape([1, size] if index == 0 else [size, 1])
        graph.insert_before(node, lifted)
        operands[index] = lifted.outputs[0]
    product = ir.Node("", "MatMul", operands, name=f"{node.name}_matrices")
    product.outputs[0].type = old.type
    axes = [-2 if index == 0 else -1 for index in vectors]
    flat = _reaxed(graph, "Squeeze", product.outputs[0], axes, f"{node.name}_result")
    graph.insert_before(node, [product, flat])
    made = flat.outputs[0]
    made.type, made.shape, name = old.type, old.shape, old.name
    ir.convenience.replace_all_uses_with(old, made, replace_graph_outputs=True)
    graph.remove(node, safe=True)
    made.name = name


def _size(vector: ir.Value | None) -> int | ir.SymbolicDim:
    assert vector is not None
    assert vector.shape is not None
    return vector.shape[0]


def _reaxed(
    graph: ir.Graph, op: str, value: ir.Value | None, axes: list[int], name: str
) -> ir.Node:
    """Return a node that adds or removes axes; the axes become a weight of ``graph``."""
    assert value is not None
    return new_node(
        op, [value, weight(graph, f"{name}_axes", np.array(axes))], name, dtype=value.dtype
    )
