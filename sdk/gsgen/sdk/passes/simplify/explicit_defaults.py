"""Writes out default attributes and inputs of nodes that some runtimes handle wrongly."""

__all__ = ["MakeDefaultsExplicit"]

from typing import Self

import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, RewriteTarget, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, rank_of, required

_AXES_INPUT_INDEX = 3


class MakeDefaultsExplicit(NodeRewrite):
    """Write out default attributes of Conv and Slice that a runtime release handles wrongly.

    onnxruntime-web 1.22 fails at the first frame of a Conv without ``dilations``, and of a Slice
    without axes::

        Conv(x, w)               →   Conv<dilations = [1, 1]>(x, w)
        Slice(x, starts, ends)   →   Slice(x, starts, ends, [0, 1])
    """

    name = "spell-out-defaults"
    wanted_by = "targets with operator tables"

    @classmethod
    def for_target(cls, target: RewriteTarget) -> Self | None:
        """Return the rewrite for a runtime; None without a list of operators that it supports."""
        return cls() if target.tables else None

    def matches(self, node: ir.Node) -> bool:
        """Return whether a Conv or Slice omits dilations or axes whose defaults are known."""
        if is_op(node, "Conv"):
            rank = rank_of(node.inputs[0])
            return "dilations" not in node.attributes and rank is not None and rank > 2
        if not is_op(node, "Slice") or len(node.inputs) < _AXES_INPUT_INDEX:
            return False
        missing = len(node.inputs) == _AXES_INPUT_INDEX or node.inputs[_AXES_INPUT_INDEX] is None
        return missing and constant_of(node.inputs[1]) is not None

    def replace(self, node: ir.Node) -> None:
        """Add the omitted dilations or axes of a Conv or Slice."""
        if is_op(node, "Conv"):
            spatial_axis_count = (rank_of(node.inputs[0]) or 2) - 2
            node.attributes["dilations"] = ir.AttrInt64s("dilations", [1] * spatial_axis_count)
            return
        starts = required(constant_of(node.inputs[1]))
        if len(node.inputs) == _AXES_INPUT_INDEX:
            node.resize_inputs(_AXES_INPUT_INDEX + 1)
        node.replace_input_with(_AXES_INPUT_INDEX, InsertionPoint(node).int64(*range(len(starts))))
