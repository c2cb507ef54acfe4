"""Rewrites GridSample of images and volumes as Gathers, which every WebGPU runtime supports."""

__all__ = ["SampleByGather"]

import math

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, TableRewrite, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousNodeRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import (
    constant_of,
    fixed_shape,
    int_attribute,
    rank_of,
    required,
)

_BILINEAR_MODES = ("bilinear", "linear")  # the name since operator set 20
_MAX_PIXELS = 1 << 24  # float32 represents every pixel index up to this number
_IMAGE_RANK, _VOLUME_RANK = 4, 5
_FLOAT, _INT32 = ir.DataType.FLOAT, ir.DataType.INT32


class SampleByGather(TableRewrite, CautiousNodeRewrite):
    """Replace a GridSample with linear interpolation by Gathers and arithmetic.

    Kernels of GridSample exist for images and operator sets 16 to 19 only; in onnxruntime-web 1.22
    its float16 shader does not compile, and the output is silently wrong. No WebGPU runtime samples
    volumes. With the image as a table [pixels, channels] and one row per point::

        1  GridSample(X, grid)   →   Σ weight · Gather(table, y · W + x), over four neighbours
        2  GridSample(V, grid)   →   Σ weight · Gather(table, (z · H + y) · W + x), over eight

    The formulas are those of ONNX and torch: the pixel coordinate is ((g + 1) / 2) (W − 1) with
    aligned corners, else ((g + 1) W − 1) / 2. Zero padding sets the weights of neighbours outside
    the image to zero; border padding moves the point to the edge. A NaN coordinate counts as
    outside. Coordinates are at least float32, because float16 cannot represent pixel indices.
    Reflection padding, nearest and cubic sampling stay as they are.
    """

    name = "sample-by-gather"
    exactness = ErrorBudget(relative=2e-6)
    wanted_by = "targets without a kernel for GridSample in the model's dtype"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node is a GridSample that lacks a kernel."""
        if not is_op(node, "GridSample"):
            return False
        # Case 2: the tables are those of images.
        is_volume = rank_of(node.inputs[0]) == _VOLUME_RANK
        return self.target is None or is_volume or self.target.lacks_kernel(node, self.opset)

    def obstacle(self, node: ir.Node) -> str:
        """Return the reason why a GridSample cannot be rewritten as Gathers; empty if it can."""
        return _find_obstacle(node)

    def replace(self, node: ir.Node) -> None:
        """Replace a GridSample by Gathers of the neighbouring pixels, and their weighted sum."""
        _replace(node)


def _find_obstacle(node: ir.Node) -> str:
    image, grid = (fixed_shape(value) for value in node.inputs)
    if image is None or grid is None:
        return "the sizes of its inputs are not known"
    if len(image) not in (_IMAGE_RANK, _VOLUME_RANK):
        return f"its image has {len(image)} axes, expected {_IMAGE_RANK} or {_VOLUME_RANK}"
    mode = _string_attribute(node, "mode", "bilinear")
    padding = _string_attribute(node, "padding_mode", "zeros")
    if mode not in _BILINEAR_MODES:
        return f"mode is {mode}, expected bilinear"
    if padding not in ("zeros", "border"):
        return f"padding is {padding}, expected zeros or border"
    if 0 in (*image, *grid):
        return "an axis is empty"
    pixels = math.prod(image) // image[1]
    if pixels >= _MAX_PIXELS:
        return f"{pixels} pixels, expected fewer than {_MAX_PIXELS}"
    return ""


def _string_attribute(node: ir.Node, name: str, default: str) -> str:
    attribute = node.attributes.get(name)
    return default if attribute is None else attribute.as_string()


def _replace(node: ir.Node) -> None:
    image, grid = required(node.inputs[0]), required(node.inputs[1])
    frames, channels, *sizes = required(fixed_shape(image))
    grid_shape = required(fixed_shape(grid))
    points = math.prod(grid_shape[:-1])
    before = InsertionPoint(node)
    kind = required(image.dtype)
    dtype = kind if kind == ir.DataType.DOUBLE else _FLOAT
    table = _pixel_table(before, image)
    flat_grid = _convert(before, grid, dtype, [points, len(sizes)])
    sampler = _Sampler(before, dtype, node)
    # The first coordinate of the grid belongs to the last axis of the image.
    neighbours = [
        sampler.neighbours(flat_grid, len(sizes) - 1 - axis, size)
        for axis, size in enumerate(sizes)
    ]
    start = None
    if frames > 1:
        first = np.repeat(np.arange(frames), points // frames) * math.prod(sizes)
        start = before.constant(first.astype(np.int32)[:, None], "frame")

    def interpolated(axis: int, start: ir.Value | None) -> ir.Value:
        """Interpolate linearly between neighbours along an axis and, recursively, later axes."""
        parts = []
        for index, weight in neighbours[axis]:
            stride = math.prod(sizes[axis + 1 :])
            if axis < len(sizes) - 1:
                index = before.op(
                    "Mul", index, before.constant(np.asarray(stride, np.int32), "stride")
                )
            index = index if start is None else before.op("Add", start, index)
            if axis < len(sizes) - 1:
                value = interpolated(axis + 1, index)
            else:
                pixel = before.op("Reshape", index, before.int64(points))
                pixels = before.op("Gather", table, pixel, dtype=kind, axis=0)
                value = _convert(before, pixels, dtype)
            parts.append(before.op("Mul", value, weight))
        return before.op("Add", *parts)

    shape = [frames, *grid_shape[1:-1], channels]
    interpolated_samples = before.op("Reshape", interpolated(0, start), before.int64(*shape))
    perm = [0, len(shape) - 1, *range(1, len(shape) - 1)]
    before.replace(_convert(before, before.op("Transpose", interpolated_samples, perm=perm), kind))


class _Sampler:
    """Computes the two neighbouring pixels of every sample point along one axis, with weights."""

    def __init__(self, before: InsertionPoint, dtype: ir.DataType, node: ir.Node) -> None:
        self.before, self.dtype = before, dtype
        self.aligns_corners = bool(int_attribute(node, "align_corners", 0))
        self.border = _string_attribute(node, "padding_mode", "zeros") == "border"

    def number(self, value: float) -> ir.Value:
        return self.before.constant(np.asarray(value, self.dtype.numpy()), "number")

    def neighbours(self, grid: ir.Value, axis: int, size: int) -> list[tuple[ir.Value, ir.Value]]:
        """Return index [P, 1] and weight [P, 1] of both neighbouring pixels along an axis."""
        op, unit = self.before.op, self.number(1)
        column = op("Gather", grid, self.before.int64(axis), dtype=self.dtype, axis=1)
        coordinate = self._pixel_coordinate(op("Add", column, unit), size)
        last = self.number(size - 1)
        if self.border:
            coordinate = self._clamp_index(coordinate, last)
        low = op("Floor", coordinate)
        high = op("Add", low, unit)
        pairs = []
        for index, weight in (
            (low, op("Sub", high, coordinate)),
            (high, op("Sub", coordinate, low)),
        ):
            masked_weight = weight if self.border else self._mask_outside(index, weight, last)
            pixel = op("Cast", self._clamp_index(index, last), dtype=_INT32, to=_INT32.value)
            pairs.append((pixel, masked_weight))
        return pairs

    def _pixel_coordinate(self, shifted_coordinate: ir.Value, size: int) -> ir.Value:
        op, half = self.before.op, self.number(2)
        if self.aligns_corners:
            return op("Mul", op("Div", shifted_coordinate, half), self.number(size - 1))
        scaled = op("Sub", op("Mul", shifted_coordinate, self.number(size)), self.number(1))
        return op("Div", scaled, half)

    def _clamp_index(self, value: ir.Value, last: ir.Value) -> ir.Value:
        """Clamp pixel coordinates to the pixels of an axis; NaN becomes 0."""
        op, zero = self.before.op, self.number(0)
        is_positive = op("Greater", value, zero, dtype=ir.DataType.BOOL)
        nonnegative_value = op("Where", is_positive, value, zero, dtype=self.dtype)
        is_small = op("Less", nonnegative_value, last, dtype=ir.DataType.BOOL)
        return op("Where", is_small, nonnegative_value, last, dtype=self.dtype)

    def _mask_outside(self, index: ir.Value, weight: ir.Value, last: ir.Value) -> ir.Value:
        op, zero = self.before.op, self.number(0)
        is_above_zero = op("GreaterOrEqual", index, zero, dtype=ir.DataType.BOOL)
        masked_weight = op("Where", is_above_zero, weight, zero, dtype=self.dtype)
        is_below = op("LessOrEqual", index, last, dtype=ir.DataType.BOOL)
        return op("Where", is_below, masked_weight, zero, dtype=self.dtype)


def _pixel_table(before: InsertionPoint, image: ir.Value) -> ir.Value:
    """Return the image to sample as a table [frames · pixels, channels]."""
    frames, channels, *sizes = required(fixed_shape(image))
    perm = [0, *range(2, 2 + len(sizes)), 1]
    known = constant_of(image, largest=1 << 62)
    if known is not None:
        transposed_table = np.ascontiguousarray(known.transpose(perm)).reshape(-1, channels)
        return before.constant(transposed_table, "table")
    transposed_image = before.op("Transpose", image, perm=perm)
    return before.op("Reshape", transposed_image, before.int64(frames * math.prod(sizes), channels))


def _convert(
    before: InsertionPoint, value: ir.Value, kind: ir.DataType, shape: list[int] | None = None
) -> ir.Value:
    if value.dtype != kind:
        value = before.op("Cast", value, dtype=kind, to=kind.value)
    return value if shape is None else before.op("Reshape", value, before.int64(*shape))
