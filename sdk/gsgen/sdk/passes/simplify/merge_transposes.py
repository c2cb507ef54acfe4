"""Merges consecutive Transpose operators."""

__all__ = ["MergeTransposes"]


import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import required


class MergeTransposes(NodeRewrite):
    """Merge consecutive Transpose operators; remove them if they cancel each other.

    Each Transpose reads and writes the whole tensor::

        Transpose(Transpose(x, p), q)   →   Transpose(x, p[q])
    """

    name = "merge-transposes"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node transposes the output of another Transpose."""
        if not is_op(node, "Transpose") or node.inputs[0] is None:
            return False
        return (
            is_op(node.inputs[0].producer(), "Transpose")
            and _permutation_of_transpose(node) is not None
        )

    def replace(self, node: ir.Node) -> None:
        """Transpose the input of two Transposes by their composed permutation."""
        inner_transpose = required(
            node.inputs[0].producer() if node.inputs[0] is not None else None
        )
        outer_permutation = required(_permutation_of_transpose(node))
        first = required(_permutation_of_transpose(inner_transpose))
        x = required(inner_transpose.inputs[0])
        perm, write = [first[axis] for axis in outer_permutation], InsertionPoint(node)
        if perm == sorted(perm):
            write.replace(x)
            return
        write.replace(write.op("Transpose", x, perm=perm))


def _permutation_of_transpose(node: ir.Node) -> list[int] | None:
    attribute = node.attributes.get("perm")
    if attribute is not None:
        return list(attribute.as_ints())
    shape = node.inputs[0].shape if node.inputs[0] is not None else None
    return None if shape is None else list(range(len(shape)))[::-1]
