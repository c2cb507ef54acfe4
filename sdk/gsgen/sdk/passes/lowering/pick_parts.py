"""Moves Gather before Concat and Transpose, so that unused parts are never computed."""

__all__ = ["LowerSplitsToSlices"]


import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute, required

_MAX_INDICES = 1 << 10


class LowerSplitsToSlices(NodeRewrite):
    """Gather from the inputs of a Concat or Transpose instead of its output.

    A deformation field joins position and time, and then gathers pairs of columns. Gathered from
    the inputs, pairs of position columns are constants, and everything that depends on them alone
    is computed once, at loading::

        1  Gather(Concat(position, time), [0, 2])       →   Gather(position, [0, 2])
        2  Transpose(Gather(Transpose(x), …, axis 0))   →   Gather(x, …, axis 1)
    """

    name = "pick-parts"

    def matches(self, node: ir.Node) -> bool:
        """Return whether a node gathers constant indices from a Concat or a Transpose."""
        if not is_op(node, "Gather") or node.inputs[0] is None:
            return False
        indices = constant_of(node.inputs[1], _MAX_INDICES)
        producer = node.inputs[0].producer()
        if (
            indices is None
            or indices.ndim != 1
            or producer is None
            or producer.graph is not node.graph
        ):
            return False
        if is_op(producer, "Concat"):
            return _indices_per_piece(node, producer) is not None
        return is_op(producer, "Transpose") and fixed_shape(producer.inputs[0]) is not None

    def replace(self, node: ir.Node) -> None:
        """Gather from the inputs of a Concat or Transpose instead of from its output."""
        producer = required(node.inputs[0].producer() if node.inputs[0] is not None else None)
        write, axis = InsertionPoint(node), _axis(node)
        if is_op(producer, "Transpose"):  # Case 2
            write.replace(_write_gather_and_transpose(write, node, producer, axis))
            return
        # Case 1: gather from each piece, and join the parts.
        piece_indices = required(_indices_per_piece(node, producer))
        parts = []
        for piece, indices in piece_indices:
            shape = fixed_shape(piece)
            is_whole_axis = shape is not None and indices == list(range(shape[axis]))
            parts.append(piece if is_whole_axis else _write_gather(write, piece, indices, axis))
        result = parts[0] if len(parts) == 1 else write.op("Concat", *parts, axis=axis)
        write.replace(result)


def _axis(node: ir.Node) -> int:
    shape = node.inputs[0].shape if node.inputs[0] is not None else None
    axis = int_attribute(node, "axis", 0)
    return axis if axis >= 0 or shape is None else axis + len(shape)


def _write_gather(
    write: InsertionPoint, value: ir.Value, indices: list[int], axis: int
) -> ir.Value:
    numbers = write.constant(np.array(indices, np.int64), "places")
    return write.op("Gather", value, numbers, axis=axis)


def _indices_per_piece(
    node: ir.Node, concat_node: ir.Node
) -> list[tuple[ir.Value, list[int]]] | None:
    """Divide a Gather's indices among a Concat's inputs; None if unknown or in too many pieces."""
    indices = constant_of(node.inputs[1], _MAX_INDICES)
    shapes = [fixed_shape(piece) for piece in concat_node.inputs]
    axis = _axis(node)
    if indices is None or any(shape is None for shape in shapes):
        return None
    rank = len(shapes[0] or ())
    if int_attribute(concat_node, "axis", 0) % rank != axis:
        return None
    ends = np.cumsum([shape[axis] for shape in shapes if shape is not None])
    if ((indices < -ends[-1]) | (indices >= ends[-1])).any():
        return None  # the runtime reports the error itself
    pieces: list[tuple[ir.Value, list[int]]] = []
    for joined_index in np.where(indices < 0, indices + ends[-1], indices):
        piece_number = int(np.searchsorted(ends, joined_index, side="right"))
        piece = required(concat_node.inputs[piece_number])
        piece_index = int(joined_index) - (int(ends[piece_number - 1]) if piece_number else 0)
        if pieces and pieces[-1][0] is piece:
            pieces[-1][1].append(piece_index)
        else:
            pieces.append((piece, [piece_index]))
    return pieces if pieces and len(pieces) <= len(concat_node.inputs) else None


def _write_gather_and_transpose(
    write: InsertionPoint, node: ir.Node, transpose: ir.Node, axis: int
) -> ir.Value:
    """Gather from the input of a Transpose, and transpose the result."""
    source = required(transpose.inputs[0])
    rank = len(source.shape) if source.shape is not None else 0
    attribute = transpose.attributes.get("perm")
    perm = list(attribute.as_ints()) if attribute is not None else list(range(rank))[::-1]
    gathered_value = write.op("Gather", source, node.inputs[1], axis=perm[axis])
    return write.op("Transpose", gathered_value, perm=perm)
