"""Rewrites scatters that add, multiply, or take a minimum or maximum as Gather and Reduce."""

__all__ = ["ReduceScatters"]

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousNodeRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import fixed_shape, numpy_dtype, required
from gsgen.sdk.passes.indexing.gather_scatters import (
    ScatterTargets,
    scatter_obstacle,
    scatter_targets,
)

_OPERATOR_BY_REDUCTION = {
    "add": "ReduceSum",
    "mul": "ReduceProd",
    "max": "ReduceMax",
    "min": "ReduceMin",
}
# The number that a sum or a product does not change; extremes repeat an element instead.
_NEUTRAL_BY_REDUCTION = {"add": 0, "mul": 1}
# The table of groups is at most this many times as large as the tensors that it gathers from.
_MAX_PADDING_ROWS = 16


class ReduceScatters(CautiousNodeRewrite):
    """Replace scatters with a reduction and constant indices by a Gather and a Reduce operator.

    They update in place: a captured graph meets the values of the previous frame, and adds to them.
    torch exports them for ``index_add``, ``scatter_reduce`` and pooling over voxels or groups::

        ScatterND<max>(x, indices, y)   →   ReduceMax(Gather(Concat(x, y), groups), axis 1)

    Row i of ``groups`` lists the old row i and all of its updates, padded to the largest group: with
    the old row for max and min, with a neutral row for sums and products. A sum may round in
    another order. Groups of very different sizes, which would be mostly padding, stay as they are.
    """

    name = "reduce-scatters"
    exactness = ErrorBudget(relative=1e-5)
    wanted_by = "every target"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node is a scatter with a reduction."""
        return (
            is_op(node, "ScatterElements", "ScatterND")
            and _scatter_reduction(node) in _OPERATOR_BY_REDUCTION
        )

    def obstacle(self, node: ir.Node) -> str:
        """Return the reason why a scatter cannot be rewritten as a reduction; empty if it can."""
        obstacle = scatter_obstacle(node)
        if obstacle:
            return obstacle
        targets = scatter_targets(node)
        most = int(np.bincount(targets.flat).max(initial=0))
        if targets.rows * (1 + most) > _MAX_PADDING_ROWS * (targets.rows + targets.flat.size):
            return f"one row has {most} updates, most have far fewer"
        return ""

    def replace(self, node: ir.Node) -> None:
        """Replace a scatter by a reduction of each old row with the row's updates."""
        targets = scatter_targets(node)
        _replace(node, targets, _groups(targets), _scatter_reduction(node))


def _scatter_reduction(node: ir.Node) -> str:
    attribute = node.attributes.get("reduction")
    return "none" if attribute is None else attribute.as_string()


def _groups(targets: ScatterTargets) -> np.ndarray:
    """Return, per row of a scatter, its index and the indices of updates to it, padded with −1."""
    order = np.argsort(targets.flat, kind="stable")
    counts = np.bincount(targets.flat, minlength=targets.rows)
    groups = np.full((targets.rows, 1 + int(counts.max(initial=0))), -1, np.int64)
    groups[:, 0] = np.arange(targets.rows)
    rank = np.arange(order.size) - np.repeat(np.cumsum(counts) - counts, counts)
    groups[targets.flat[order], 1 + rank] = targets.rows + order
    return groups


def _replace(node: ir.Node, targets: ScatterTargets, groups: np.ndarray, reduction: str) -> None:
    write = InsertionPoint(node)
    data, _, updates = node.inputs
    old_rows = write.op("Reshape", data, write.int64(targets.rows, *targets.row_shape))
    # A size of zero would mean the size of the updates' first axis.
    new_rows = write.op(
        "Reshape", updates, write.int64(targets.flat.size or -1, *targets.row_shape)
    )
    parts, padding = [old_rows, new_rows], groups[:, :1]
    if reduction in _NEUTRAL_BY_REDUCTION:
        padding = np.full_like(groups[:, :1], targets.rows + targets.flat.size)
        shape = (1, *targets.row_shape)
        parts.append(
            write.constant(
                np.full(shape, _NEUTRAL_BY_REDUCTION[reduction], numpy_dtype(old_rows)), "neutral"
            )
        )
    joined_rows = write.op("Concat", *parts, axis=0)
    index = np.where(groups < 0, padding, groups)
    gathered_rows = write.op("Gather", joined_rows, write.constant(index, "groups"), axis=0)
    reduced = write.op(_OPERATOR_BY_REDUCTION[reduction], gathered_rows, write.int64(1), keepdims=0)
    write.replace(write.op("Reshape", reduced, write.int64(*required(fixed_shape(data)))))
