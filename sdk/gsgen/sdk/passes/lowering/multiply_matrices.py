"""Rewrites products with vectors as matrix products, which every runtime computes correctly."""

__all__ = ["MultiplyMatrices"]

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import new_node, weight
from gsgen.sdk.passes.framework.value_facts import required


class MultiplyMatrices(NodeRewrite):
    """Turn vector operands of every MatMul into matrices.

    ONNX Runtime (observed in 1.31) fuses Transpose into MatMul, and computes A v instead of Aᵀ v
    if v has one axis: the camera centre −Rᵀ t is wrong, without any error. Also,
    onnxruntime-web 1.22 has no kernel for operands of one axis::

        1  MatMul(A, v)   →   Squeeze(MatMul(A, Unsqueeze(v, 1)), -1)
        2  MatMul(v, B)   →   Squeeze(MatMul(Unsqueeze(v, 0), B), -2)
    """

    name = "multiply-matrices"
    exactness = ErrorBudget(relative=1e-6)

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node is a MatMul with a vector operand (rank 1)."""
        return bool(_vector_operands(node))

    def replace(self, node: ir.Node) -> None:
        """Add an axis to each vector of a MatMul, and remove the axis from the product."""
        graph = node.graph
        assert isinstance(graph, ir.Graph)
        vectors, old = _vector_operands(node), node.outputs[0]
        operands = list(node.inputs)
        for index in vectors:
            axis = 0 if index == 0 else 1  # Case 2: the left vector is a row. Case 1: a column.
            operands_2d = _reshape_axes(
                graph, "Unsqueeze", operands[index], [axis], f"{node.name}_{index}"
            )
            size = required(required(operands[index]).shape)[0]
            operands_2d.outputs[0].shape = ir.Shape([1, size] if index == 0 else [size, 1])
            graph.insert_before(node, operands_2d)
            operands[index] = operands_2d.outputs[0]
        product = ir.Node("", "MatMul", operands, name=f"{node.name}_matrices")
        product.outputs[0].type = old.type
        axes = [-2 if index == 0 else -1 for index in vectors]
        squeezed_product = _reshape_axes(
            graph, "Squeeze", product.outputs[0], axes, f"{node.name}_result"
        )
        graph.insert_before(node, [product, squeezed_product])
        product_value = squeezed_product.outputs[0]
        product_value.type, product_value.shape, name = old.type, old.shape, old.name
        ir.convenience.replace_all_uses_with(old, product_value, replace_graph_outputs=True)
        graph.remove(node, safe=True)
        product_value.name = name


def _vector_operands(node: ir.Node) -> list[int]:
    """Return the indices of the inputs of a MatMul that are vectors (rank 1)."""
    if not is_op(node, "MatMul"):
        return []
    shapes = [value.shape if value is not None else None for value in node.inputs]
    return [index for index, shape in enumerate(shapes) if shape is not None and len(shape) == 1]


def _reshape_axes(
    graph: ir.Graph, op: str, value: ir.Value | None, axes: list[int], name: str
) -> ir.Node:
    """Return a Squeeze or Unsqueeze node, with its axes as a weight of the graph."""
    axes_weight = weight(graph, f"{name}_axes", np.array(axes))
    return new_node(op, [value, axes_weight], name, dtype=required(value).dtype)
