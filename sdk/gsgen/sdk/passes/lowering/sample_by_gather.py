"""Bilinear sampling that every WebGPU runtime can do."""

__all__ = ["SampleByGather"]

from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ByTables, ErrorBudget, every_node, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute

_BILINEAR = ("bilinear", "linear")  # the name since operator set 20
_WIDEST = 1 << 24  # float32 counts pixels one by one up to here
_FLOAT, _INT = ir.DataType.FLOAT, ir.DataType.INT32


class SampleByGather(ByTables, CautiousRewrite):
    """Write a bilinear GridSample with four Gathers and arithmetic.

    Kernels of GridSample exist for operator sets 16 to 19 alone; in onnxruntime-web 1.22 its
    float16 shader does not compile, and the output is silently wrong. With the image as a table of
    [pixels, channels] and one row a point::

        GridSample(X, grid)   →   Σ weight · Gather(table, y · W + x) over the four neighbours

    The formulas are those of ONNX and torch: a pixel's place is ((g + 1) / 2) (W − 1) where corners
    are aligned, else ((g + 1) W − 1) / 2. Padding by zeros gives neighbours outside the weight
    zero; padding by the border moves the point to the edge. A coordinate that is NaN counts as
    outside. Coordinates are computed in float32 at least, since float16 cannot number pixels.
    Reflection, nearest and cubic sampling, and volumes, are left alone.
    """

    name: ClassVar[str] = "sample-by-gather"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=2e-6)
    wanted_by: ClassVar[str] = (
        "targets without a kernel for GridSample in the model's dtype"
    )

    def rewrite(self, model: ir.Model) -> None:
        """Rewrite every GridSample that lacks a kernel, subgraphs included."""
        for node in [node for node in every_node(model) if is_op(node, "GridSample")]:
            if self.goal is not None and not self.goal.lacks(node, self.opset):
                continue
            why = _obstacle(node)
            if why:
                self.refuse(node, why)
                continue
            self.note(node)
            _replace(node)


def _obstacle(node: ir.Node) -> str:
    """Say what keeps ``node`` from being written out; nothing where nothing does."""
    image, grid = (fixed_shape(value) for value in node.inputs)
    if image is None or grid is None:
        return "the sizes of its inputs are not known"
    if len(image) != 4:
        return f"its image has {len(image)} axes, wanted 4"
    mode, padding = _word(node, "mode", "bilinear"), _word(node, "padding_mode", "zeros")
    if mode not in _BILINEAR:
        return f"mode is {mode}, wanted bilinear"
    if padding not in ("zeros", "border"):
        return f"padding is {padding}, wanted zeros or border"
    if 0 in (*image, *grid):
        return "an axis is empty"
    if image[0] * image[2] * image[3] >= _WIDEST:
        return f"{image[0] * image[2] * image[3]} pixels, wanted fewer than {_WIDEST}"
    return ""


def _word(node: ir.Node, name: str, default: str) -> str:
    attribute = node.attributes.get(name)
    return default if attribute is None else attribute.as_string()


def _replace(node: ir.Node) -> None:
    image, grid = node.inputs
    assert image is not None
    assert grid is not None
    frames, channels, height, width = fixed_shape(image) or ()
    points = int(np.prod((fixed_shape(grid) or ())[:-1]))
    before = InsertionPoint(node)
    kind = image.dtype
    assert kind is not None
    wide = kind if kind == ir.DataType.DOUBLE else _FLOAT
    table = _table(before, image)
    flat = _as(before, grid, wide, [points, 2])
    sampler = _Sampler(before, wide, node)
    xs = sampler.neighbours(flat, 0, width)
    ys = sampler.neighbours(flat, 1, height)
    first = np.repeat(np.arange(frames), points // frames) * (height * width)
    start = before.constant(first.astype(np.int32)[:, None], "frame")
    rows = []
    for y_index, y_weight in ys:
        line = before.op(
            "Mul", y_index, before.constant(np.asarray(width, np.int32), "width")
        )
        line = before.op("Add", line, start) if frames > 1 else line
        parts = []
        for x_index, x_weight in xs:
            place = before.op("Add", line, x_index)
            place = before.op("Reshape", place, before.whole(points))
            taken = before.op("Gather", table, place, dtype=kind, axis=0)
            parts.append(before.op("Mul", _as(before, taken, wide), x_weight))
        rows.append(before.op("Mul", before.op("Add", *parts), y_weight))
    mixed = before.op("Add", *rows)
    shape = [frames, *(fixed_shape(grid) or ())[1:-1], channels]
    mixed = before.op("Reshape", mixed, before.whole(*shape))
    made = before.op("Transpose", mixed, perm=[0, 3, 1, 2])
    before.replace(_as(before, made, kind))


class _Sampler:
    """Finds the two neighbours of every point along one axis."""

    def __init__(self, before: InsertionPoint, wide: ir.DataType, node: ir.Node) -> None:
        self.before, self.wide = before, wide
        self.aligned = bool(int_attribute(node, "align_corners", 0))
        self.border = _word(node, "padding_mode", "zeros") == "border"

    def number(self, value: float) -> ir.Value:
        return self.before.constant(np.asarray(value, self.wide.numpy()), "number")

    def neighbours(
        self, grid: ir.Value, axis: int, size: int
    ) -> list[tuple[ir.Value, ir.Value]]:
        """Return (index int32 [P, 1], weight [P, 1]) of the lower and the upper neighbour."""
        op, one = self.before.op, self.number(1)
        column = op("Gather", grid, self.before.whole(axis), dtype=self.wide, axis=1)
        place = self._place(op("Add", column, one), size)
        last = self.number(size - 1)
        if self.border:
            place = self._within(place, last)
        low = op("Floor", place)
        high = op("Add", low, one)
        made = []
        for index, weight in ((low, op("Sub", high, place)), (high, op("Sub", place, low))):
            kept = weight if self.border else self._where_inside(index, weight, last)
            whole = op("Cast", self._within(index, last), dtype=_INT, to=_INT.value)
            made.append((whole, kept))
        return made

    def _place(self, moved: ir.Value, size: int) -> ir.Value:
        op, half = self.before.op, self.number(2)
        if self.aligned:
            return op("Mul", op("Div", moved, half), self.number(size - 1))
        scaled = op("Sub", op("Mul", moved, self.number(size)), self.number(1))
        return op("Div", scaled, half)

    def _within(self, value: ir.Value, last: ir.Value) -> ir.Value:
        """Bring ``value`` into 0 … ``last``; NaN, which no comparison keeps, becomes 0."""
        op, zero = self.before.op, self.number(0)
        positive = op("Greater", value, zero, dtype=ir.DataType.BOOL)
        raised = op("Where", positive, value, zero, dtype=self.wide)
        small = op("Less", raised, last, dtype=ir.DataType.BOOL)
        return op("Where", small, raised, last, dtype=self.wide)

    def _where_inside(self, index: ir.Value, weight: ir.Value, last: ir.Value) -> ir.Value:
        op, zero = self.before.op, self.number(0)
        above = op("GreaterOrEqual", index, zero, dtype=ir.DataType.BOOL)
        kept = op("Where", above, weight, zero, dtype=self.wide)
        below = op("LessOrEqual", index, last, dtype=ir.DataType.BOOL)
        return op("Where", below, kept, zero, dtype=self.wide)


def _table(before: InsertionPoint, image: ir.Value) -> ir.Value:
    """Return the image as [frames · pixels, channels]; a weight is turned here and now."""
    frames, channels, height, width = fixed_shape(image) or ()
    known = constant_of(image, largest=1 << 62)
    if known is not None:
        turned = np.ascontiguousarray(known.transpose(0, 2, 3, 1)).reshape(-1, channels)
        return before.constant(turned, "table")
    turned_value = before.op("Transpose", image, perm=[0, 2, 3, 1])
    return before.op(
        "Reshape", turned_value, before.whole(frames * height * width, channels)
    )


def _as(
    before: InsertionPoint,
    value: ir.Value,
    kind: ir.DataType,
    shape: list[int] | None = None,
) -> ir.Value:
    """Return ``value`` in this dtype and shape."""
    if value.dtype != kind:
        value = before.op("Cast", value, dtype=kind, to=kind.value)
    return value if shape is None else before.op("Reshape", value, before.whole(*shape))
