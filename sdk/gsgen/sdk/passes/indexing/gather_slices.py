"""Replaces Split by Slice, and some Slice and GatherND by Gather, where runtimes lack a kernel."""

__all__ = ["GatherSlices"]

import math
from itertools import pairwise

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import SubstituteNodes, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import (
    UNBOUNDED_END,
    constant_of,
    fixed_shape,
    int_attribute,
    required,
    split_sizes,
)


class GatherSlices(SubstituteNodes):
    """Replace Split by Slice, and Slice and GatherND by Gather, where a runtime has no kernel.

    onnxruntime-web 1.22 splits neither float16 nor int32, 1.30 does not slice int32, and 1.22 fails
    at the first frame of a GatherND with constant indices, which torch exports for ``x[:, (0, 2)]``.
    Every release has Gather kernels for all of these::

        1  a, b = Split(x)          →   Slice(x, 0, n), Slice(x, n, n + m)
        2  Slice(x, 2, 8, step 3)   →   Gather(x, [2, 5])
        3  GatherND(x, constant)    →   Gather(Reshape(x), constant)
    """

    name = "gather-slices"
    kinds = frozenset({"GatherND", "Slice", "Split"})

    def variant(self, node: ir.Node) -> str:
        """Return the variant: GatherND of ``constant`` indices, ``backwards`` Slice, or empty."""
        if is_op(node, "GatherND"):
            return "constant" if constant_of(node.inputs[1]) is not None else ""
        steps = constant_of(node.inputs[4]) if len(node.inputs) > 4 else None
        return "backwards" if steps is not None and (steps < 0).any() else ""

    def can_replace(self, node: ir.Node) -> bool:
        """Return whether a node's sizes, bounds or indices are known before the first frame."""
        if is_op(node, "Split"):
            return split_sizes(node) is not None and self.opset >= 10
        if is_op(node, "Slice"):
            return _axis_indices(node) is not None
        known = constant_of(node.inputs[1], largest=1 << 24)
        return (
            known is not None
            and known.ndim > 0
            and fixed_shape(node.inputs[0]) is not None
            and int_attribute(node, "batch_dims", 0) == 0
        )

    def replace(self, node: ir.Node) -> None:
        """Replace a Split by Slices, or a Slice or GatherND by Gathers."""
        write, x = InsertionPoint(node), required(node.inputs[0])
        if is_op(node, "Split"):  # Case 1
            write.replace(*_split_slices(write, node, x))
        elif is_op(node, "Slice"):  # Case 2
            parts = required(_axis_indices(node))
            gathered_value = x
            for axis, indices in parts:
                gathered_value = write.op(
                    "Gather", gathered_value, write.constant(indices, "places"), axis=axis
                )
            write.replace(gathered_value if parts else write.op("Identity", x))
        else:  # Case 3
            write.replace(_gather_nd(write, node, x))


def _split_slices(write: InsertionPoint, node: ir.Node, x: ir.Value) -> list[ir.Value]:
    axis, sizes = int_attribute(node, "axis", 0), required(split_sizes(node))
    ends = np.cumsum([0, *sizes])
    slices = []
    for begin, end in pairwise(ends):
        numbers = (write.int64(int(begin)), write.int64(int(end)), write.int64(axis))
        slices.append(write.op("Slice", x, *numbers))
    return slices


def _axis_indices(node: ir.Node) -> list[tuple[int, np.ndarray]] | None:
    """Return the indices that a Slice selects on each axis; None if they are unknown."""
    shape = fixed_shape(node.inputs[0])
    arguments = [constant_of(value) for value in node.inputs[1:]]
    given_inputs = [value for value in node.inputs[1:] if value is not None]
    if shape is None or len(given_inputs) != sum(array is not None for array in arguments):
        return None
    slice_starts, ends, axes, steps = (*arguments, None, None)[:4]
    if slice_starts is None or ends is None:
        return None
    axes = np.arange(len(slice_starts)) if axes is None else axes
    steps = np.ones(len(slice_starts), np.int64) if steps is None else steps
    parts = []
    for begin, end, axis, step in zip(slice_starts, ends, axes, steps, strict=True):
        size = shape[axis]
        if step < 0 and (end >= UNBOUNDED_END or size == 0):
            return None  # the ONNX standard and ONNX Runtime disagree
        indices = np.arange(size, dtype=np.int64)[slice(*_clipped_slice(begin, end, step, size))]
        if len(indices) != size or step != 1:
            parts.append((int(axis) % len(shape), indices))
    return parts


def _clipped_slice(begin: int, end: int, step: int, size: int) -> tuple[int, int | None, int]:
    """Convert the bounds of an ONNX Slice to those of a Python slice."""
    first = int(begin) + size if begin < 0 else int(begin)
    end_index = int(end) + size if end < 0 else int(end)
    if step > 0:
        return min(max(first, 0), size), min(max(end_index, 0), size), int(step)
    first, end_index = min(max(first, 0), size - 1), min(max(end_index, -1), size - 1)
    return first, None if end_index < 0 else end_index, int(step)


def _gather_nd(write: InsertionPoint, node: ir.Node, x: ir.Value) -> ir.Value:
    """Rewrite a GatherND as a Gather: merge the indexed axes, and flatten the multi-indices."""
    indices = required(constant_of(node.inputs[1], largest=1 << 24))
    shape = required(fixed_shape(x))
    depth = indices.shape[-1]
    indexed_shape, row_shape = shape[:depth], shape[depth:]
    wrapped_indices = np.where(indices < 0, indices + np.array(indexed_shape, np.int64), indices)
    flat_indices = np.zeros(indices.shape[:-1], np.int64)
    for axis, size in enumerate(indexed_shape):
        flat_indices = flat_indices * size + wrapped_indices[..., axis]
    rows = x
    if depth > 1:
        rows = write.op("Reshape", x, write.int64(math.prod(indexed_shape), *row_shape))
    return write.op("Gather", rows, write.constant(flat_indices, "places"), axis=0)
