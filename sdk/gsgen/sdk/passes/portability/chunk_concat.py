"""Concats that a shader stage can bind."""

__all__ = ["ChunkConcat"]

from collections.abc import Sequence
from itertools import pairwise
from typing import ClassVar

import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, WithinLimit, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint


class ChunkConcat(WithinLimit, NodeRewrite):
    """Write a Concat of more than seven inputs as a tree of smaller ones.

    WebGPU guarantees eight storage buffers a shader stage. A Concat binds one for each input and
    one for its result; onnxruntime-web 1.22 gives garbage where there are more, with nothing but
    an uncaptured device error::

        Concat(a, …, n)   →   Concat(Concat(a, …, g), Concat(h, …, n))
    """

    name: ClassVar[str] = "chunk-concat"
    wanted_by: ClassVar[str] = "targets with a limit `concat_inputs`: visionary, core"
    limited_by: ClassVar[str] = "concat_inputs"

    def matches(self, node: ir.Node) -> bool:
        """Say whether ``node`` joins more than the limit."""
        return is_op(node, "Concat") and len(node.inputs) > self.limit

    def replace(self, node: ir.Node) -> None:
        """Join neighbours, as many as may be, until few enough are left."""
        axis, write = node.attributes["axis"].as_int(), InsertionPoint(node)
        parts: list[ir.Value | None] = list(node.inputs)
        while len(parts) > 1:
            parts = [
                write.op("Concat", *group, axis=axis) if len(group) > 1 else group[0]
                for group in _groups(parts, self.limit)
            ]
        (whole,) = parts
        assert whole is not None
        write.replace(whole)


def _groups(
    parts: Sequence[ir.Value | None], limit: int
) -> list[Sequence[ir.Value | None]]:
    """Cut ``parts`` into as few groups as may be, all about as large."""
    count = -(-len(parts) // limit)
    ends = [len(parts) * k // count for k in range(count + 1)]
    return [parts[a:b] for a, b in pairwise(ends)]
