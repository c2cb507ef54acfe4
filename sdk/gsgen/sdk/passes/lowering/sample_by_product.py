"""Rewrites GridSample along a line of fixed points as matrix products."""

__all__ = ["SampleByProduct"]

from dataclasses import dataclass

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import fixed_shape, int_attribute, required

# The matrix of weights is held in memory; beyond this size, sampling is cheaper.
_MAX_WEIGHT_BYTES = 1 << 26
_FLOAT = ir.DataType.FLOAT


class SampleByProduct(CautiousRewrite):
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
        varying = _varying(model.graph)
        for node in list(model.graph.all_nodes()):
            if not is_op(node, "GridSample"):
                continue
            line = _line(node, varying)
            if isinstance(line, str):
                if line:
                    self.refuse(node, line)
                continue
            self.note(node)
            _replace(node, line)


@dataclass(frozen=True, slots=True)
class _Line:
    fixed: ir.Value  # the constant coordinate of each point, [n, 1]
    common: ir.Value  # the common coordinate, one number
    common_is_x: bool  # whether the common coordinate is x


def _varying(graph: ir.Graph) -> set[ir.Value]:
    """Return the values of a graph that depend on a graph input."""
    varying = {value for value in graph.inputs if value.name not in graph.initializers}
    for node in graph:
        if varying.intersection(value for value in node.inputs if value is not None):
            varying.update(node.outputs)
    return varying


def _line(node: ir.Node, varying: set[ir.Value]) -> _Line | str:
    """Return the line of points that a GridSample node samples, or why a rewrite is impossible.

    The reason is empty if the points do not lie on such a line at all.
    """
    plane, grid = node.inputs
    shapes = fixed_shape(plane), fixed_shape(grid)
    if plane is None or grid is None or shapes[0] is None or shapes[1] is None:
        return "its shapes are not known"
    if grid not in varying:
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
    join = _producer_before_reshapes(grid)
    if join is None or not is_op(join, "Concat") or len(join.inputs) != 2:
        return ""
    x, y = join.inputs
    count = shapes[1][1] * shapes[1][2]
    for fixed, varying_coordinate, common_is_x in ((y, x, True), (x, y, False)):
        common = None if varying_coordinate is None else _common_number(varying_coordinate)
        if fixed is None or common is None or fixed in varying:
            continue
        if fixed_shape(fixed) != (count, 1) or fixed_shape(varying_coordinate) != (count, 1):
            continue
        if 4 * count * shapes[0][2 if common_is_x else 3] > _MAX_WEIGHT_BYTES:
            return f"weights of {count} points would take too much memory"
        return _Line(fixed, common, common_is_x)
    return ""


def _producer_before_reshapes(value: ir.Value | None) -> ir.Node | None:
    """Return the node that computes a graph value, ignoring reshapes."""
    maker = value.producer() if value is not None else None
    while maker is not None and is_op(maker, "Reshape", "Unsqueeze", "Squeeze"):
        maker = maker.inputs[0].producer() if maker.inputs[0] is not None else None
    return maker


def _common_number(value: ir.Value) -> ir.Value | None:
    """Return the number that an Expand repeats in all elements; None for other tensors."""
    maker = _producer_before_reshapes(value)
    if maker is None or not is_op(maker, "Expand"):
        return None
    source = maker.inputs[0]
    shape = fixed_shape(source)
    return source if shape is not None and int(np.prod(shape)) == 1 else None


def _replace(node: ir.Node, line: _Line) -> None:
    write = InsertionPoint(node)
    plane, grid = node.inputs
    shape, points = required(fixed_shape(plane)), required(fixed_shape(grid))
    _, channels, height, width = shape
    common, fixed = (width, height) if line.common_is_x else (height, width)
    # The plane as a matrix: a row for each cell of the common axis.
    order = [3, 2, 1] if line.common_is_x else [2, 3, 1]
    turned = write.op("Transpose", plane, perm=[*order, 0])
    rows = write.op("Reshape", turned, write.int64(common, fixed * channels))
    mix = _hat_weights(write, node, write.op("Reshape", line.common, write.int64(1, 1)), common)
    row = write.op("Reshape", write.op("MatMul", mix, rows), write.int64(fixed, channels))
    samples = write.op("MatMul", _hat_weights(write, node, line.fixed, fixed), row)
    flat = write.op("Transpose", samples, perm=[1, 0])
    write.replace(write.op("Reshape", flat, write.int64(1, channels, points[1], points[2])))


def _hat_weights(write: InsertionPoint, node: ir.Node, coordinate: ir.Value, size: int) -> ir.Value:
    """Return linear interpolation weights [n, size] of pixels at coordinates from −1 to 1."""

    def number(value: float) -> ir.Value:
        return write.constant(np.asarray(value, np.float32), "number")

    if int_attribute(node, "align_corners", 0):
        scale, shift = (size - 1) / 2, (size - 1) / 2
    else:
        scale, shift = size / 2, (size - 1) / 2
    cell = write.op("Add", write.op("Mul", coordinate, number(scale)), number(shift))
    attribute = node.attributes.get("padding_mode")
    if attribute is not None and attribute.as_string() == "border":
        cell = write.op("Clip", cell, number(0), number(size - 1))
    cells = write.constant(np.arange(size, dtype=np.float32)[None], "cells")
    distance = write.op("Abs", write.op("Sub", cell, cells))
    return write.op("Relu", write.op("Sub", number(1), distance))
