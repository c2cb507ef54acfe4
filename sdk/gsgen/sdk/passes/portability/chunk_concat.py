"""Splits Concats with many inputs, so that a GPU shader can bind all inputs."""

__all__ = ["ChunkConcat"]

from collections.abc import Sequence
from itertools import pairwise

import onnx_ir as ir

from gsgen.sdk.passes.framework.base import LimitRewrite, NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint


class ChunkConcat(LimitRewrite, NodeRewrite):
    """Replace a Concat of more than seven inputs by a tree of smaller Concats.

    WebGPU guarantees eight storage buffers per shader stage. A Concat binds one for each input and
    one for its output; with more, onnxruntime-web 1.22 returns garbage and reports nothing but an
    uncaptured device error::

        Concat(a, …, n)   →   Concat(Concat(a, …, g), Concat(h, …, n))
    """

    name = "chunk-concat"
    wanted_by = "targets with a limit `concat_inputs`: visionary, core"
    limited_by = "concat_inputs"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node is a Concat with more inputs than the limit."""
        return is_op(node, "Concat") and len(node.inputs) > self.limit

    def replace(self, node: ir.Node) -> None:
        """Concatenate groups of a Concat's inputs, then the results, until one tensor is left."""
        axis, write = node.attributes["axis"].as_int(), InsertionPoint(node)
        parts: list[ir.Value | None] = list(node.inputs)
        while len(parts) > 1:
            parts = [
                write.op("Concat", *group, axis=axis) if len(group) > 1 else group[0]
                for group in _groups(parts, self.limit)
            ]
        (single_part,) = parts
        assert single_part is not None
        write.replace(single_part)


def _groups(parts: Sequence[ir.Value | None], limit: int) -> list[Sequence[ir.Value | None]]:
    """Divide consecutive tensors into as few groups as possible, of about equal size."""
    count = -(-len(parts) // limit)
    ends = [len(parts) * k // count for k in range(count + 1)]
    return [parts[a:b] for a, b in pairwise(ends)]
