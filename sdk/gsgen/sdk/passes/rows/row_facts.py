"""What is known of tensors whose number of rows a mask decides."""

__all__ = ["Blocked", "Fact", "Filler", "Index", "Linear", "Mask", "Rows", "read_mask"]

from dataclasses import dataclass
from math import prod

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import fixed_shape


class Blocked(Exception):
    """A node stands in the way of a static shape."""

    def __init__(self, node: ir.Node, why: str, masks: frozenset["Mask"]) -> None:
        super().__init__(why)
        self.node, self.why, self.masks = node, why, masks


@dataclass(frozen=True, slots=True)
class Mask:
    """A tensor of truth values; K of its elements are true.

    Attributes:
        root: The tensor, of any numeric dtype: what is not zero is true.
        dims: Its shape.
        behind: Sizes along which it is repeated: Expand(Unsqueeze(root), …).
        within: The mask that kept the rows among which this one chooses.
    """

    root: ir.Value
    dims: tuple[int, ...]
    behind: tuple[int, ...] = ()
    within: "Mask | None" = None

    @property
    def bare(self) -> "Mask":
        """The mask without repetition: it keeps the same rows."""
        return Mask(self.root, self.dims, within=self.within)

    @property
    def chain(self) -> "tuple[Mask, ...]":
        """The mask, and those among whose rows it chooses."""
        return (self.bare, *(self.within.chain if self.within is not None else ()))

    @property
    def size(self) -> int:
        """How many elements it has."""
        return prod(self.dims)


@dataclass(frozen=True, slots=True)
class Index:
    """Where a mask is true, as NonZero says it.

    Attributes:
        mask: The mask.
        form: ``columns`` [axes, K], ``rows`` [K, axes] or ``flat`` [K].
    """

    mask: Mask
    form: str


@dataclass(frozen=True, slots=True)
class Rows:
    """A tensor with K rows, and the one with all N rows, in place, that it is a part of.

    Attributes:
        mask: Which rows it has.
        value: The tensor of all rows.
        axis: Along which axis rows lie.
        flat: The K rows stand flattened in one axis.
    """

    mask: Mask
    value: ir.Value
    axis: int
    flat: bool = False


@dataclass(frozen=True, slots=True)
class Linear:
    """Whole numbers that are a + b · K.

    Attributes:
        mask: What K counts.
        constant: The numbers a, of any shape.
        factor: The numbers b.
        varies: They are computed from a shape that varies, so they must be computed anew.
    """

    mask: Mask
    constant: np.ndarray
    factor: np.ndarray
    varies: bool


@dataclass(frozen=True, slots=True)
class Filler:
    """``capacity`` − K equal rows, along the first axis.

    Attributes:
        mask: What K counts.
        capacity: Rows that it fills up to.
        row: What one row holds, a constant.
    """

    mask: Mask
    capacity: int
    row: np.ndarray


Fact = Index | Rows | Linear | Filler


def read_mask(value: ir.Value | None) -> Mask | None:
    """Return the mask that ``value`` is, seen through casts, flattening and repetition."""
    root = _truth(value)
    dims = fixed_shape(root)
    if root is None or dims is None:
        return None
    maker = root.producer()
    if maker is None or not is_op(maker, "Expand"):
        return Mask(root, dims)
    inner = fixed_shape(maker.inputs[0])
    raised = maker.inputs[0].producer() if maker.inputs[0] is not None else None
    if inner is None or raised is None or not is_op(raised, "Unsqueeze"):
        return Mask(root, dims)
    base = _truth(raised.inputs[0])
    kept = fixed_shape(base)
    if base is None or kept is None or inner != (*kept, *[1] * (len(inner) - len(kept))):
        return Mask(root, dims)
    same_rank = len(dims) == len(inner) and dims[: len(kept)] == kept
    return Mask(base, kept, dims[len(kept) :]) if same_rank else Mask(root, dims)


def _truth(value: ir.Value | None) -> ir.Value | None:
    """Return the tensor that says the same, before casts of booleans and flattening of vectors."""
    while value is not None:
        maker = value.producer()
        given = maker.inputs[0] if maker is not None and maker.inputs else None
        if maker is None or given is None or not _says_the_same(maker, given, value):
            return value
        value = given
    return None


def _says_the_same(node: ir.Node, given: ir.Value, made: ir.Value) -> bool:
    if is_op(node, "Identity"):
        return True
    if is_op(node, "Cast"):
        return given.dtype == ir.DataType.BOOL
    same = fixed_shape(given) is not None and fixed_shape(given) == fixed_shape(made)
    return is_op(node, "Reshape", "Expand") and same
