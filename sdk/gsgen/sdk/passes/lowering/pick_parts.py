"""Parts of what was joined, without joining it."""

__all__ = ["PickParts"]

from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute

_FEW = 1 << 10


class PickParts(NodeRewrite):
    """Take parts from what a Concat joins, or a Transpose turns, rather than from its result.

    A deformation field joins position and time, and then looks at pairs of columns. Taken from the
    pieces, the pairs of positions alone are constants, and all that follows from them is computed
    once, at loading::

        Gather(Concat(place, time), [0, 2])         →   Gather(place, [0, 2])
        Transpose(Gather(Transpose(x), …, axis 0))   →   Gather(x, …, axis 1)
    """

    name: ClassVar[str] = "pick-parts"

    def matches(self, node: ir.Node) -> bool:
        """Say whether ``node`` takes known places of what was joined or turned."""
        if not is_op(node, "Gather") or node.inputs[0] is None:
            return False
        places = constant_of(node.inputs[1], _FEW)
        maker = node.inputs[0].producer()
        if (
            places is None
            or places.ndim != 1
            or maker is None
            or maker.graph is not node.graph
        ):
            return False
        if is_op(maker, "Concat"):
            return _spread(node, maker) is not None
        return is_op(maker, "Transpose") and fixed_shape(maker.inputs[0]) is not None

    def replace(self, node: ir.Node) -> None:
        """Take the parts one step earlier."""
        maker = node.inputs[0].producer() if node.inputs[0] is not None else None
        assert maker is not None
        write, axis = InsertionPoint(node), _axis(node)
        if is_op(maker, "Transpose"):
            write.replace(_turned_later(write, node, maker, axis))
            return
        spread = _spread(node, maker)
        assert spread is not None
        parts = []
        for piece, places in spread:
            shape = fixed_shape(piece)
            whole = shape is not None and places == list(range(shape[axis]))
            parts.append(piece if whole else _taken(write, piece, places, axis))
        made = parts[0] if len(parts) == 1 else write.op("Concat", *parts, axis=axis)
        write.replace(made)


def _axis(node: ir.Node) -> int:
    shape = node.inputs[0].shape if node.inputs[0] is not None else None
    axis = int_attribute(node, "axis", 0)
    return axis if axis >= 0 or shape is None else axis + len(shape)


def _taken(
    write: InsertionPoint, value: ir.Value, places: list[int], axis: int
) -> ir.Value:
    numbers = write.constant(np.array(places, np.int64), "places")
    return write.op("Gather", value, numbers, axis=axis)


def _spread(node: ir.Node, join: ir.Node) -> list[tuple[ir.Value, list[int]]] | None:
    """Return pieces and the places to take of each, in order; None where that is not simpler."""
    places = constant_of(node.inputs[1], _FEW)
    shapes = [fixed_shape(piece) for piece in join.inputs]
    axis = _axis(node)
    if places is None or any(shape is None for shape in shapes):
        return None
    rank = len(shapes[0] or ())
    if int_attribute(join, "axis", 0) % rank != axis:
        return None
    ends = np.cumsum([shape[axis] for shape in shapes if shape is not None])
    if ((places < -ends[-1]) | (places >= ends[-1])).any():
        return None  # the runtime reports what is wrong with it, with its own words
    found: list[tuple[ir.Value, list[int]]] = []
    for place in np.where(places < 0, places + ends[-1], places):
        index = int(np.searchsorted(ends, place, side="right"))
        piece = join.inputs[index]
        assert piece is not None
        inside = int(place) - (int(ends[index - 1]) if index else 0)
        if found and found[-1][0] is piece:
            found[-1][1].append(inside)
        else:
            found.append((piece, [inside]))
    return found if found and len(found) <= len(join.inputs) else None


def _turned_later(
    write: InsertionPoint, node: ir.Node, turn: ir.Node, axis: int
) -> ir.Value:
    """Take the parts first and turn them then."""
    source = turn.inputs[0]
    assert source is not None
    rank = len(source.shape) if source.shape is not None else 0
    given = turn.attributes.get("perm")
    perm = list(given.as_ints()) if given is not None else list(range(rank))[::-1]
    taken = write.op("Gather", source, node.inputs[1], axis=perm[axis])
    return write.op("Transpose", taken, perm=perm)
