"""Transposes of transposes."""

__all__ = ["MergeTransposes"]

from typing import ClassVar

import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint


class MergeTransposes(NodeRewrite):
    """Turn once where a Transpose follows a Transpose; not at all where they undo each other.

    Every one of them reads and writes the whole tensor::

        Transpose(Transpose(x, p), q)   →   Transpose(x, p[q])
    """

    name: ClassVar[str] = "merge-transposes"

    def matches(self, node: ir.Node) -> bool:
        """Say whether ``node`` turns what was just turned."""
        if not is_op(node, "Transpose") or node.inputs[0] is None:
            return False
        return is_op(node.inputs[0].producer(), "Transpose") and _perm(node) is not None

    def replace(self, node: ir.Node) -> None:
        """Turn what the first took."""
        inner = node.inputs[0].producer() if node.inputs[0] is not None else None
        outer = _perm(node)
        assert inner is not None
        first = _perm(inner)
        x = inner.inputs[0]
        assert first is not None
        assert outer is not None
        assert x is not None
        perm, write = [first[axis] for axis in outer], InsertionPoint(node)
        if perm == sorted(perm):
            write.replace(x)
            return
        write.replace(write.op("Transpose", x, perm=perm))


def _perm(node: ir.Node) -> list[int] | None:
    given = node.attributes.get("perm")
    if given is not None:
        return list(given.as_ints())
    shape = node.inputs[0].shape if node.inputs[0] is not None else None
    return None if shape is None else list(range(len(shape)))[::-1]
