"""Divides Splits with many outputs, so that a GPU shader can bind all outputs."""

__all__ = ["ChunkSplit"]

from itertools import pairwise

import onnx_ir as ir

from gsgen.sdk.passes.framework.base import LimitRewrite, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import split_sizes

# From this operator set on, the sizes are an input; before, an attribute.
_SIZES_ARE_INPUT = 13


class ChunkSplit(LimitRewrite, SkippableRewrite):
    """Replace a Split with more than seven outputs by a tree of smaller Splits.

    A Split binds one storage buffer for its input and one for each output, and WebGPU guarantees
    eight. Above the adapter's limit it fails at the first frame, not at loading::

        a, …, n = Split(x)   →   left, right = Split(x); a, …, g = Split(left); h, …, n = Split(right)
    """

    name = "chunk-split"
    wanted_by = "targets with a limit `split_outputs`: webgpu, visionary, core"
    limited_by = "split_outputs"

    def rewrite(self, model: ir.Model) -> None:
        """Replace every Split that has known sizes and too many outputs by a tree of Splits."""
        for node in list(model.graph.all_nodes()):
            if not is_op(node, "Split") or len(node.outputs) <= self.limit:
                continue
            sizes = split_sizes(node)
            if sizes is None:
                self.refuse(node, "the sizes of its outputs are not known before the frame")
                continue
            self.note(node)
            self._split(node, sizes)

    def _split(self, node: ir.Node, sizes: list[int]) -> None:
        write = InsertionPoint(node)
        axis = node.attributes["axis"].as_int() if "axis" in node.attributes else 0
        parts = [(node.inputs[0], sizes)]
        while any(len(part_sizes) > 1 for _, part_sizes in parts):
            split_parts: list[tuple[ir.Value | None, list[int]]] = []
            for value, part_sizes in parts:
                groups = self._groups(part_sizes)
                group_sizes = [sum(group) for group in groups]
                split_values = (
                    self._split_chunk_once(write, value, group_sizes, axis)
                    if len(groups) > 1
                    else [value]
                )
                split_parts += zip(split_values, groups, strict=True)
            parts = split_parts
        write.replace(*(value for value, _ in parts if value is not None))

    def _groups(self, sizes: list[int]) -> list[list[int]]:
        """Divide the output sizes of a Split into as many groups as one Split may return."""
        count = min(self.limit, len(sizes))
        ends = [len(sizes) * k // count for k in range(count + 1)]
        return [sizes[a:b] for a, b in pairwise(ends)]

    def _split_chunk_once(
        self, write: InsertionPoint, value: ir.Value | None, sizes: list[int], axis: int
    ) -> list[ir.Value]:
        if self.opset >= _SIZES_ARE_INPUT:
            return write.ops("Split", len(sizes), value, write.int64(*sizes), axis=axis)
        return write.ops("Split", len(sizes), value, axis=axis, split=sizes)
