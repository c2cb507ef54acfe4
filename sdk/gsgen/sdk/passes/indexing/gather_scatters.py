"""Rewrites scatters with constant indices as gathers, which do not update buffers in place."""

__all__ = ["GatherScatters", "ScatterTargets", "scatter_obstacle", "scatter_targets"]

import math
from dataclasses import dataclass

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousNodeRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute, required

_MAX_INDICES = 1 << 24


class GatherScatters(CautiousNodeRewrite):
    """Replace scatters with constant indices by a Gather from the joined old and new elements.

    ScatterND and ScatterElements update in place. If their base is an input, a weight or a tensor
    that other nodes read, a captured graph is wrong from its first frame on, without any error;
    and onnxruntime-web 1.22 has no correct kernel. torch exports them for ``x[:, 0] = y``::

        ScatterND(x, indices, y)   →   Gather(Concat(x, y), index of each element's last update)
    """

    name = "gather-scatters"
    wanted_by = "every target"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node is a scatter."""
        return is_op(node, "ScatterElements", "ScatterND")

    def obstacle(self, node: ir.Node) -> str:
        """Return the reason why a scatter cannot be rewritten as a Gather; empty if it can."""
        reduction = node.attributes.get("reduction")
        if reduction is not None and reduction.as_string() != "none":
            return f"it does not replace elements: its reduction is {reduction.as_string()!r}"
        return scatter_obstacle(node)

    def replace(self, node: ir.Node) -> None:
        """Replace a scatter by a Gather from the joined old and new elements."""
        write = InsertionPoint(node)
        data, _, updates = node.inputs
        targets = scatter_targets(node)
        order = np.arange(targets.rows, dtype=np.int64)
        # If several updates have the same index, the last one counts; NumPy assigns in this order.
        order[targets.flat] = targets.rows + np.arange(targets.flat.size)
        old_rows = write.op("Reshape", data, write.int64(targets.rows, *targets.row_shape))
        # A size of zero would mean the size of the updates' first axis.
        new_rows = write.op(
            "Reshape", updates, write.int64(targets.flat.size or -1, *targets.row_shape)
        )
        joined_rows = write.op("Concat", old_rows, new_rows, axis=0)
        gathered_rows = write.op("Gather", joined_rows, write.constant(order, "order"), axis=0)
        write.replace(write.op("Reshape", gathered_rows, write.int64(*required(fixed_shape(data)))))


def scatter_obstacle(node: ir.Node) -> str:
    """Return the reason why the rows that a scatter updates are unknown; empty if they are known."""
    if constant_of(node.inputs[1], largest=_MAX_INDICES) is None:
        return "its indices are not known before the frame"
    shape = fixed_shape(node.inputs[0])
    if shape is None:
        return "the shape of the updated tensor is not known"
    return "the updated tensor is empty" if 0 in shape else ""


@dataclass(frozen=True, slots=True)
class ScatterTargets:
    """The rows that a scatter with constant indices updates."""

    rows: int  # rows of the updated tensor
    row_shape: tuple[int, ...]  # the shape of a row; empty for ScatterElements
    flat: np.ndarray  # for each update, the index of its row


def scatter_targets(node: ir.Node) -> ScatterTargets:
    """Return the indices of the rows that a scatter with constant indices updates."""
    shape = required(fixed_shape(node.inputs[0]))
    indices = required(constant_of(node.inputs[1], largest=_MAX_INDICES))
    if is_op(node, "ScatterND"):
        depth = indices.shape[-1]
        row_shape = shape[depth:]
        flat = _flat_indices(indices, shape[:depth])
    else:
        axis = int_attribute(node, "axis", 0) % len(shape)
        index = np.indices(indices.shape)
        index[axis] = np.where(indices < 0, indices + shape[axis], indices)
        row_shape, flat = (), _flat_indices(np.moveaxis(index, 0, -1), shape)
    rows = math.prod(shape) // max(math.prod(row_shape), 1) if math.prod(row_shape) else 0
    return ScatterTargets(rows, row_shape, flat.reshape(-1))


def _flat_indices(indices: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """Return flat element indices for multi-indices; negative ones count from an axis' end."""
    flat = np.zeros(indices.shape[:-1], np.int64)
    for axis, size in enumerate(sizes):
        index = indices[..., axis]
        flat = flat * size + np.where(index < 0, index + size, index)
    return flat
