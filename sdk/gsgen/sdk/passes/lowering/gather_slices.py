"""Parts of a tensor, by operators that have kernels."""

__all__ = ["GatherSlices"]

import math
from itertools import pairwise
from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import Substitute, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import (
    constant_of,
    fixed_shape,
    int_attribute,
    split_sizes,
)

_ENDLESS = 2**31 - 1


class GatherSlices(Substitute):
    """Take parts by Slice where Split has no kernel, and by Gather where Slice or GatherND has none.

    onnxruntime-web 1.22 splits neither float16 nor int32, 1.30 does not slice int32, and 1.22 fails
    at the first frame of a GatherND with constant indices, which is what torch exports for
    ``x[:, (0, 2)]``. Gather has kernels for all of these everywhere::

        a, b = Split(x)          →   Slice(x, 0, n), Slice(x, n, n + m)
        Slice(x, 2, 8, step 3)   →   Gather(x, [2, 5])
        GatherND(x, constant)    →   Gather(Reshape(x), constant)
    """

    name: ClassVar[str] = "gather-slices"
    kinds: ClassVar[frozenset[str]] = frozenset({"GatherND", "Slice", "Split"})

    def variant(self, node: ir.Node) -> str:
        """Return ``constant`` of a GatherND, ``backwards`` of a Slice, where they are that."""
        if is_op(node, "GatherND"):
            return "constant" if constant_of(node.inputs[1]) is not None else ""
        steps = constant_of(node.inputs[4]) if len(node.inputs) > 4 else None
        return "backwards" if steps is not None and (steps < 0).any() else ""

    def suits(self, node: ir.Node) -> bool:
        """Say whether the parts are known before the frame."""
        if is_op(node, "Split"):
            return split_sizes(node) is not None and self.opset >= 10
        if is_op(node, "Slice"):
            return _parts(node) is not None
        known = constant_of(node.inputs[1], largest=1 << 24)
        return (
            known is not None
            and known.ndim > 0
            and fixed_shape(node.inputs[0]) is not None
            and int_attribute(node, "batch_dims", 0) == 0
        )

    def replace(self, node: ir.Node) -> None:
        """Take the parts another way."""
        write, x = InsertionPoint(node), node.inputs[0]
        assert x is not None
        if is_op(node, "Split"):
            write.replace(*_slices(write, node, x))
        elif is_op(node, "Slice"):
            parts = _parts(node)
            assert parts is not None
            made = x
            for axis, places in parts:
                made = write.op("Gather", made, write.constant(places, "places"), axis=axis)
            write.replace(made if parts else write.op("Identity", x))
        else:
            write.replace(_places(write, node, x))


def _slices(write: InsertionPoint, node: ir.Node, x: ir.Value) -> list[ir.Value]:
    axis, sizes = int_attribute(node, "axis", 0), split_sizes(node)
    assert sizes is not None
    ends = np.cumsum([0, *sizes])
    made = []
    for begin, end in pairwise(ends):
        numbers = (write.whole(int(begin)), write.whole(int(end)), write.whole(axis))
        made.append(write.op("Slice", x, *numbers))
    return made


def _parts(node: ir.Node) -> list[tuple[int, np.ndarray]] | None:
    """Return axis and places of each cut that a Slice makes; None where they are not known."""
    shape = fixed_shape(node.inputs[0])
    given = [constant_of(value) for value in node.inputs[1:]]
    wanted = [value for value in node.inputs[1:] if value is not None]
    if shape is None or len(wanted) != sum(array is not None for array in given):
        return None
    begins, ends, axes, steps = (*given, None, None)[:4]
    if begins is None or ends is None:
        return None
    axes = np.arange(len(begins)) if axes is None else axes
    steps = np.ones(len(begins), np.int64) if steps is None else steps
    parts = []
    for begin, end, axis, step in zip(begins, ends, axes, steps, strict=True):
        size = shape[axis]
        if step < 0 and (end >= _ENDLESS or size == 0):
            return None  # the standard and ONNX Runtime disagree
        chosen = np.arange(size, dtype=np.int64)[slice(*_clipped(begin, end, step, size))]
        if len(chosen) != size or step != 1:
            parts.append((int(axis) % len(shape), chosen))
    return parts


def _clipped(begin: int, end: int, step: int, size: int) -> tuple[int, int | None, int]:
    """Return a slice as Python wants it: ``None`` stands for "before the first"."""
    first = int(begin) + size if begin < 0 else int(begin)
    last = int(end) + size if end < 0 else int(end)
    if step > 0:
        return min(max(first, 0), size), min(max(last, 0), size), int(step)
    first, last = min(max(first, 0), size - 1), min(max(last, -1), size - 1)
    return first, None if last < 0 else last, int(step)


def _places(write: InsertionPoint, node: ir.Node, x: ir.Value) -> ir.Value:
    """Write a GatherND: the axes that it looks into become one, and each place one number."""
    indices, shape = constant_of(node.inputs[1], largest=1 << 24), fixed_shape(x)
    assert indices is not None
    assert shape is not None
    depth = indices.shape[-1]
    looked, rest = shape[:depth], shape[depth:]
    inside = np.where(indices < 0, indices + np.array(looked, np.int64), indices)
    flat = np.zeros(indices.shape[:-1], np.int64)
    for axis, size in enumerate(looked):
        flat = flat * size + inside[..., axis]
    rows = x
    if depth > 1:
        rows = write.op("Reshape", x, write.whole(math.prod(looked), *rest))
    return write.op("Gather", rows, write.constant(flat, "places"), axis=0)
