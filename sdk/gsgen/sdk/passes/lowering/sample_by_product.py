"""Rewrites GridSample along a line of fixed points as matrix products."""

__all__ = ["SampleByProduct"]

from dataclasses import dataclass

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import fixed_shape, int_attribute, required

# The matrix of weights is held in memory; beyond this size, sampling is cheaper.
_MAX_WEIGHT_BYTES = 1 << 26
_FLOAT = ir.DataType.FLOAT


class SampleByProduct(SkippableRewrite):
    """Replace a bilinear GridSample by two products, if all points share one coordinate.

    A HexPlane (arXiv 2310.08528, sec. 4.2) samples planes of space and time: a point's position is
    fixed, and time is one number for all points. Bilinear weights factor, so the rows of the plane
    are first interpolated at the time; each point's weights, which are constants, follow::

        GridSample(plane, (x, t))   →   hat(x) · (hat(t) · plane), where hat(u)ᵢ = max(0, 1 − |u − i|)

    ONNX Runtime's CPU samples points one by one; a product runs at full speed on every device,
    without lookups. Hat weights outside the plane are zero; border padding clips the coordinate.
    """

    name = "sample-by-product"
    exactness = ErrorBudget(relative=2e-5)

    def rewrite(self, model: ir.Model) -> None:
        """Rewrite every GridSample along a line of fixed points as two matrix products."""
        varying_values = _varying_values(model.graph)
        for node in list(model.graph.all_nodes()):
            if not is_op(node, "GridSample"):
                continue
            sampled_line = _sampled_line(node, varying_values)
            if isinstance(sampled_line, str):
                if sampled_line:
                    self.refuse(node, sampled_line)
                continue
            self.note(node)
            _replace(node, sampled_line)


@dataclass(frozen=True, slots=True)
class _SampledLine:
    fixed_coordinate: ir.Value  # the constant coordinate of each point, [n, 1]
    common_coordinate: ir.Value  # the common coordinate, one number
    is_common_x: bool  # whether the common coordinate is x


def _varying_values(graph: ir.Graph) -> set[ir.Value]:
    """Return the values of a graph that depend on a graph input."""
    varying_values = {value for value in graph.inputs if value.name not in graph.initializers}
    for node in graph:
        if varying_values.intersection(value for value in node.inputs if value is not None):
            varying_values.update(node.outputs)
    return varying_values


def _sampled_line(node: ir.Node, varying_values: set[ir.Value]) -> _SampledLine | str:
    """Return the line of points that a GridSample node samples, or why a rewrite is impossible.

    The reason is empty if the points do not lie on such a line at all.
    """
    plane, grid = node.inputs
    shapes = fixed_shape(plane), fixed_shape(grid)
    if plane is None or grid is None or shapes[0] is None or shapes[1] is None:
        return "its shapes are not known"
    if grid not in varying_values:
        return ""
    if len(shapes[0]) != 4 or shapes[0][0] != 1 or plane.dtype != _FLOAT or grid.dtype != _FLOAT:
        return ""
    modes = {
        name: attribute.as_string()
        for name, attribute in node.attributes.items()
        if name != "align_corners"
    }
    if modes.get("mode", "bilinear") not in ("bilinear", "linear"):
        return f"its mode is {modes['mode']}, expected bilinear"
    if modes.get("padding_mode", "zeros") == "reflection":
        return "its padding is reflection, expected zeros or border"
    concat = _producer_before_reshapes(grid)
    if concat is None or not is_op(concat, "Concat") or len(concat.inputs) != 2:
        return ""
    x, y = concat.inputs
    count = shapes[1][1] * shapes[1][2]
    for fixed_coordinate, varying_coordinate, is_common_x in ((y, x, True), (x, y, False)):
        common_coordinate = (
            None if varying_coordinate is None else _common_scalar(varying_coordinate)
        )
        if (
            fixed_coordinate is None
            or common_coordinate is None
            or fixed_coordinate in varying_values
        ):
            continue
        if fixed_shape(fixed_coordinate) != (count, 1) or fixed_shape(varying_coordinate) != (
            count,
            1,
        ):
            continue
        if 4 * count * shapes[0][2 if is_common_x else 3] > _MAX_WEIGHT_BYTES:
            return f"weights of {count} points would take too much memory"
        return _SampledLine(fixed_coordinate, common_coordinate, is_common_x)
    return ""


def _producer_before_reshapes(value: ir.Value | None) -> ir.Node | None:
    """Return the node that computes a graph value, ignoring reshapes."""
    source_node = value.producer() if value is not None else None
    while source_node is not None and is_op(source_node, "Reshape", "Unsqueeze", "Squeeze"):
        source_node = (
            source_node.inputs[0].producer() if source_node.inputs[0] is not None else None
        )
    return source_node


def _common_scalar(value: ir.Value) -> ir.Value | None:
    """Return the number that an Expand repeats in all elements; None for other tensors."""
    source_node = _producer_before_reshapes(value)
    if source_node is None or not is_op(source_node, "Expand"):
        return None
    source = source_node.inputs[0]
    shape = fixed_shape(source)
    return source if shape is not None and int(np.prod(shape)) == 1 else None


def _replace(node: ir.Node, sampled_line: _SampledLine) -> None:
    write = InsertionPoint(node)
    plane, grid = node.inputs
    shape, points = required(fixed_shape(plane)), required(fixed_shape(grid))
    _, channels, height, width = shape
    common_coordinate, fixed_coordinate = (
        (width, height) if sampled_line.is_common_x else (height, width)
    )
    # The plane as a matrix: a row for each cell of the common axis.
    order = [3, 2, 1] if sampled_line.is_common_x else [2, 3, 1]
    transposed_plane = write.op("Transpose", plane, perm=[*order, 0])
    rows = write.op(
        "Reshape", transposed_plane, write.int64(common_coordinate, fixed_coordinate * channels)
    )
    mixed_samples = _hat_weights(
        write,
        node,
        write.op("Reshape", sampled_line.common_coordinate, write.int64(1, 1)),
        common_coordinate,
    )
    row = write.op(
        "Reshape", write.op("MatMul", mixed_samples, rows), write.int64(fixed_coordinate, channels)
    )
    samples = write.op(
        "MatMul", _hat_weights(write, node, sampled_line.fixed_coordinate, fixed_coordinate), row
    )
    transposed_samples = write.op("Transpose", samples, perm=[1, 0])
    write.replace(
        write.op("Reshape", transposed_samples, write.int64(1, channels, points[1], points[2]))
    )


def _hat_weights(write: InsertionPoint, node: ir.Node, coordinate: ir.Value, size: int) -> ir.Value:
    """Return linear interpolation weights [n, size] of pixels at coordinates from −1 to 1."""

    def number(value: float) -> ir.Value:
        return write.constant(np.asarray(value, np.float32), "number")

    if int_attribute(node, "align_corners", 0):
        scale, offset = (size - 1) / 2, (size - 1) / 2
    else:
        scale, offset = size / 2, (size - 1) / 2
    cell = write.op("Add", write.op("Mul", coordinate, number(scale)), number(offset))
    attribute = node.attributes.get("padding_mode")
    if attribute is not None and attribute.as_string() == "border":
        cell = write.op("Clip", cell, number(0), number(size - 1))
    cells = write.constant(np.arange(size, dtype=np.float32)[None], "cells")
    distance = write.op("Abs", write.op("Sub", cell, cells))
    return write.op("Relu", write.op("Sub", number(1), distance))
