"""Facts about tensors whose number of rows depends on a boolean mask."""

__all__ = [
    "Index",
    "Linear",
    "Mask",
    "MaskBlocked",
    "PaddingRowsFact",
    "RowTensorFact",
    "Rows",
    "read_mask",
]

from dataclasses import dataclass
from math import prod

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import fixed_shape


class MaskBlocked(Exception):
    """Raised if a node prevents static shapes for rows that a mask selects."""

    def __init__(self, node: ir.Node, reason: str, masks: frozenset["Mask"]) -> None:
        super().__init__(reason)
        self.node, self.reason, self.masks = node, reason, masks


@dataclass(frozen=True, slots=True)
class Mask:
    """A boolean row mask of a graph; K of its N elements are true."""

    root: ir.Value  # the tensor, of any numeric dtype; nonzero elements are true
    dims: tuple[int, ...]  # its shape
    # sizes of the axes along which it is repeated: Expand(Unsqueeze(root), …)
    repeats: tuple[int, ...] = ()
    parent: "Mask | None" = None  # the mask among whose rows this one selects

    @property
    def without_repeats(self) -> "Mask":
        """The row mask before it was repeated for each column; both select the same rows."""
        return Mask(self.root, self.dims, parent=self.parent)

    @property
    def chain(self) -> "tuple[Mask, ...]":
        """The mask and its parent masks; each mask selects among the rows of its parent."""
        return (self.without_repeats, *(self.parent.chain if self.parent is not None else ()))

    @property
    def size(self) -> int:
        """The number of elements of the row mask."""
        return prod(self.dims)


@dataclass(frozen=True, slots=True)
class Index:
    """The indices of the true elements of a mask, as NonZero returns them."""

    mask: Mask
    index_form: str  # ``columns`` [axes, K], ``rows`` [K, axes] or ``flat`` [K]


@dataclass(frozen=True, slots=True)
class Rows:
    """A tensor of the K rows that a mask selects, represented by a tensor of all N rows."""

    mask: Mask  # the mask that selects the K rows
    value: ir.Value  # the tensor of all N rows
    axis: int  # the axis of the rows
    flat: bool = False  # whether the K rows are flattened to one axis


@dataclass(frozen=True, slots=True)
class Linear:
    """Integers of the form a + b · K, where K is the number of rows that a mask selects."""

    mask: Mask  # the mask with K true elements
    constant: np.ndarray  # the numbers a, of any shape
    factor: np.ndarray  # the numbers b
    varies: bool  # whether a varying shape provides them, so that they must be recomputed


@dataclass(frozen=True, slots=True)
class PaddingRowsFact:
    """Equal filler rows that pad K selected rows to a fixed capacity."""

    mask: Mask  # the mask with K true elements
    capacity: int  # number of rows, filler included
    row: np.ndarray  # the constant content of a row


RowTensorFact = Index | Rows | Linear | PaddingRowsFact


def read_mask(value: ir.Value | None) -> Mask | None:
    """Return the boolean row mask from which casts, reshapes and repeats compute a graph value."""
    root = _truth_source(value)
    dims = fixed_shape(root)
    if root is None or dims is None:
        return None
    producer = root.producer()
    if producer is None or not is_op(producer, "Expand"):
        return Mask(root, dims)
    inner_shape = fixed_shape(producer.inputs[0])
    unsqueeze_node = producer.inputs[0].producer() if producer.inputs[0] is not None else None
    if inner_shape is None or unsqueeze_node is None or not is_op(unsqueeze_node, "Unsqueeze"):
        return Mask(root, dims)
    source_mask = _truth_source(unsqueeze_node.inputs[0])
    base_shape = fixed_shape(source_mask)
    if (
        source_mask is None
        or base_shape is None
        or inner_shape != (*base_shape, *[1] * (len(inner_shape) - len(base_shape)))
    ):
        return Mask(root, dims)
    same_rank = len(dims) == len(inner_shape) and dims[: len(base_shape)] == base_shape
    return Mask(source_mask, base_shape, dims[len(base_shape) :]) if same_rank else Mask(root, dims)


def _truth_source(value: ir.Value | None) -> ir.Value | None:
    """Return the tensor before casts and reshapes that keep each element's truth value."""
    while value is not None:
        producer = value.producer()
        source = producer.inputs[0] if producer is not None and producer.inputs else None
        if producer is None or source is None or not _does_keep_mask_truth(producer, source, value):
            return value
        value = source
    return None


def _does_keep_mask_truth(node: ir.Node, source: ir.Value, result: ir.Value) -> bool:
    if is_op(node, "Identity"):
        return True
    if is_op(node, "Cast"):
        return source.dtype == ir.DataType.BOOL
    is_same_shape = fixed_shape(source) is not None and fixed_shape(source) == fixed_shape(result)
    return is_op(node, "Reshape", "Expand") and is_same_shape
