"""Recognises the operators by which exporters and authors select rows with a boolean mask."""

__all__ = [
    "compose_masks", "compress_rows", "gather_nested_rows", "gather_rows", "nonzero_index",
    "transform_index",
]  # fmt: skip

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute, rank_of
from gsgen.sdk.passes.rows.row_draft import RowDraft
from gsgen.sdk.passes.rows.row_facts import Index, Mask, Rows, read_mask


def nonzero_index(node: ir.Node) -> Index | None:
    """Return the indices that NonZero computes from a row mask; None for an unknown mask."""
    mask = read_mask(node.inputs[0])
    return None if mask is None or not mask.size else Index(mask, "columns")


def compose_masks(rows: Rows, draft: RowDraft) -> Mask | None:
    """Compose two nested row masks into one mask over the original rows."""
    shape = fixed_shape(rows.value)
    if rows.flat or shape != (rows.mask.size,):
        return None
    kind = ir.DataType.BOOL
    inner_mask = rows.value
    if inner_mask.dtype != kind:
        inner_mask = draft.op("Cast", inner_mask, dtype=kind, shape=shape, to=kind.value)
    combined_mask = draft.op(
        "And", draft.boolean_mask(rows.mask), inner_mask, dtype=kind, shape=shape
    )
    return Mask(combined_mask, shape, parent=rows.mask.without_repeats)


def compress_rows(node: ir.Node, mask: Mask, draft: RowDraft) -> Rows | None:
    """Return the rows that a Compress selects; None if the condition is shorter than the axis."""
    value, shape = node.inputs[0], fixed_shape(node.inputs[0])
    if value is None or shape is None or len(mask.dims) != 1 or mask.repeats:
        return None
    axis = node.attributes.get("axis")
    if axis is None:
        value = draft.reshaped(value, [int(np.prod(shape))])
        return Rows(mask, value, 0) if mask.size == np.prod(shape) else None
    row_axis = axis.as_int() % len(shape)
    return Rows(mask, value, row_axis) if mask.size == shape[row_axis] else None


def transform_index(node: ir.Node, index: Index) -> Index | None:
    """Return a row mask's indices after a node reshaped or cast them; None if unknown."""
    if is_op(node, "Cast", "Identity") or (is_op(node, "Max") and len(node.inputs) == 1):
        return index
    if is_op(node, "Transpose") and index.index_form != "flat":
        order = node.attributes.get("perm")
        if order is not None and list(order.as_ints()) == [0, 1]:
            return index
        return Index(index.mask, "rows" if index.index_form == "columns" else "columns")
    if len(index.mask.dims) + len(index.mask.repeats) != 1:
        return None
    if is_op(node, "Gather") and index.index_form != "flat":
        # Case 1: element 0 along the axis of size one.
        zero, axis = constant_of(node.inputs[1]), int_attribute(node, "axis", 0) % 2
        is_row_axis = zero is not None and zero.ndim == 0 and zero == 0
        return (
            Index(index.mask, "flat") if is_row_axis and _axis_of_size_one(index) == axis else None
        )
    if is_op(node, "Slice") and index.index_form != "flat":
        # Case 2: the only column (or row): torch separates indices by axes in this way.
        axes = constant_of(node.inputs[3]) if len(node.inputs) > 3 else np.zeros(1, np.int64)
        start = constant_of(node.inputs[1])
        is_single_index = (
            axes is not None and axes.size == 1 and int(axes[0]) % 2 == _axis_of_size_one(index)
        )
        return index if is_single_index and start is not None and not start.any() else None
    rank = rank_of(node.outputs[0])
    if is_op(node, "Squeeze", "Reshape", "Expand") and rank == 1:
        return Index(index.mask, "flat")  # Case 3: K numbers of any layout
    if is_op(node, "Unsqueeze") and index.index_form == "flat":
        axes = constant_of(node.inputs[1]) if len(node.inputs) > 1 else None
        is_last_axis = axes is not None and int(axes.reshape(-1)[0]) in (1, -1)
        return Index(index.mask, "rows" if is_last_axis else "columns")
    if is_op(node, "Reshape") and rank == 2:
        shape = constant_of(node.inputs[1])
        return Index(index.mask, "rows") if shape is not None and shape[1] == 1 else None
    return None


def _axis_of_size_one(index: Index) -> int:
    return 0 if index.index_form == "columns" else 1


def gather_rows(node: ir.Node, index: Index, draft: RowDraft) -> Rows | None:
    """Return the rows that Gather or GatherND selects with the indices of a row mask."""
    value, shape, mask = node.inputs[0], fixed_shape(node.inputs[0]), index.mask
    if value is None or shape is None or mask.repeats or mask.parent is not None:
        return None
    if is_op(node, "Gather"):
        axis = int_attribute(node, "axis", 0) % len(shape)
        is_valid = index.index_form == "flat" and len(mask.dims) == 1 and shape[axis] == mask.size
        return Rows(mask, value, axis) if is_valid else None
    axes = len(mask.dims)
    if (
        index.index_form != "rows"
        or int_attribute(node, "batch_dims", 0)
        or shape[:axes] != mask.dims
    ):
        return None
    return Rows(mask, draft.reshaped(value, [mask.size, *shape[axes:]]), 0)


def gather_nested_rows(node: ir.Node, rows: Rows, index: Index) -> Rows | None:
    """Return the rows that Gather or GatherND selects among rows that a mask selected."""
    if rows.flat or index.mask.parent != rows.mask.without_repeats:
        return None
    rank = rank_of(rows.value) or 1
    if is_op(node, "Gather"):
        gather_axis = int_attribute(node, "axis", 0) % rank
        is_valid = index.index_form == "flat" and gather_axis == rows.axis
    else:
        is_valid = index.index_form == "rows" and rows.axis == 0
        is_valid = is_valid and not int_attribute(node, "batch_dims", 0)
    return Rows(index.mask, rows.value, rows.axis) if is_valid else None
