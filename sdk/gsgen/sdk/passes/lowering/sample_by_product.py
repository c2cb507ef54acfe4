"""Samples of a plane along a line that moves as a whole."""

__all__ = ["SampleByProduct"]

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import fixed_shape, int_attribute

# The matrix of weights is held in memory; beyond this, taking samples is cheaper.
_MOST_BYTES = 1 << 26
_FLOAT = ir.DataType.FLOAT


class SampleByProduct(CautiousRewrite):
    """Write a bilinear GridSample as two products, where one coordinate is the same for all points.

    A HexPlane (arXiv 2310.08528, sec. 4.2) samples planes of space and time: the place of a point is
    fixed, and time is one number for all. Bilinear weights factor, so a row of the plane is mixed
    for the time first, and each point's weights, which are constants, are applied to that::

        GridSample(plane, (x, t))   →   hat(x) · (hat(t) · plane), where hat(u)ᵢ = max(0, 1 − |u − i|)

    ONNX Runtime's CPU samples points one by one; a product runs at full speed on every device, and
    looks nothing up. Weights outside of the plane are zero by themselves; padding with the border
    clips the coordinate.
    """

    name: ClassVar[str] = "sample-by-product"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=2e-5)

    def rewrite(self, model: ir.Model) -> None:
        """Rewrite every sample of a line whose points are fixed."""
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
    """A line of points, one coordinate of which is common.

    Attributes:
        fixed: The other coordinate [n, 1]; it depends on no input.
        common: One number.
        across: Whether the common coordinate is x.
    """

    fixed: ir.Value
    common: ir.Value
    across: bool


def _varying(graph: ir.Graph) -> set[ir.Value]:
    """Return the values that depend on an input of the graph."""
    found = {value for value in graph.inputs if value.name not in graph.initializers}
    for node in graph:
        if found.intersection(value for value in node.inputs if value is not None):
            found.update(node.outputs)
    return found


def _line(node: ir.Node, varying: set[ir.Value]) -> _Line | str:
    """Return the line that ``node`` samples; in words, why there is none; no word if it is a field."""
    plane, grid = node.inputs
    shapes = fixed_shape(plane), fixed_shape(grid)
    if plane is None or grid is None or shapes[0] is None or shapes[1] is None:
        return "its shapes are not known"
    if grid not in varying:
        return ""
    if (
        len(shapes[0]) != 4
        or shapes[0][0] != 1
        or plane.dtype != _FLOAT
        or grid.dtype != _FLOAT
    ):
        return ""
    modes = {
        name: one.as_string()
        for name, one in node.attributes.items()
        if name != "align_corners"
    }
    if modes.get("mode", "bilinear") not in ("bilinear", "linear"):
        return f"its mode is {modes['mode']}"
    if modes.get("padding_mode", "zeros") == "reflection":
        return "its padding reflects"
    join = _through_shapes(grid)
    if join is None or not is_op(join, "Concat") or len(join.inputs) != 2:
        return ""
    x, y = join.inputs
    count = shapes[1][1] * shapes[1][2]
    for fixed, other, across in ((y, x, True), (x, y, False)):
        common = None if other is None else _common(other)
        if fixed is None or common is None or fixed in varying:
            continue
        if fixed_shape(fixed) != (count, 1) or fixed_shape(other) != (count, 1):
            continue
        if 4 * count * shapes[0][2 if across else 3] > _MOST_BYTES:
            return f"weights of {count} points would take too much memory"
        return _Line(fixed, common, across)
    return ""


def _through_shapes(value: ir.Value | None) -> ir.Node | None:
    """Return what made ``value``, apart from its shape."""
    maker = value.producer() if value is not None else None
    while maker is not None and is_op(maker, "Reshape", "Unsqueeze", "Squeeze"):
        maker = maker.inputs[0].producer() if maker.inputs[0] is not None else None
    return maker


def _common(value: ir.Value) -> ir.Value | None:
    """Return the one number that all of ``value`` is; None where it is not one."""
    maker = _through_shapes(value)
    if maker is None or not is_op(maker, "Expand"):
        return None
    source = maker.inputs[0]
    shape = fixed_shape(source)
    return source if shape is not None and int(np.prod(shape)) == 1 else None


def _replace(node: ir.Node, line: _Line) -> None:
    write = InsertionPoint(node)
    plane, grid = node.inputs
    shape, points = fixed_shape(plane), fixed_shape(grid)
    assert shape is not None
    assert points is not None
    _, channels, height, width = shape
    common, fixed = (width, height) if line.across else (height, width)
    # The plane as rows of the common axis, each the other axis by channels.
    order = [3, 2, 1] if line.across else [2, 3, 1]
    turned = write.op("Transpose", plane, perm=[*order, 0])
    rows = write.op("Reshape", turned, write.whole(common, fixed * channels))
    mix = _hat(write, node, write.op("Reshape", line.common, write.whole(1, 1)), common)
    row = write.op("Reshape", write.op("MatMul", mix, rows), write.whole(fixed, channels))
    made = write.op("MatMul", _hat(write, node, line.fixed, fixed), row)
    flat = write.op("Transpose", made, perm=[1, 0])
    write.replace(write.op("Reshape", flat, write.whole(1, channels, points[1], points[2])))


def _hat(write: InsertionPoint, node: ir.Node, place: ir.Value, size: int) -> ir.Value:
    """Return the weight of each of ``size`` cells for each coordinate [n, 1] from −1 to 1."""

    def number(value: float) -> ir.Value:
        return write.constant(np.asarray(value, np.float32), "number")

    if int_attribute(node, "align_corners", 0):
        scale, shift = (size - 1) / 2, (size - 1) / 2
    else:
        scale, shift = size / 2, (size - 1) / 2
    cell = write.op("Add", write.op("Mul", place, number(scale)), number(shift))
    given = node.attributes.get("padding_mode")
    if given is not None and given.as_string() == "border":
        cell = write.op("Clip", cell, number(0), number(size - 1))
    cells = write.constant(np.arange(size, dtype=np.float32)[None], "cells")
    apart = write.op("Abs", write.op("Sub", cell, cells))
    return write.op("Relu", write.op("Sub", number(1), apart))
