"""The nodes that masked rows are rewritten to, while it is not yet sure that they all can be."""

__all__ = ["RowDraft"]

from collections.abc import Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.detached_graph import Detached
from gsgen.sdk.passes.framework.value_facts import fixed_shape
from gsgen.sdk.passes.rows.row_facts import Linear, Mask, Rows
from gsgen.sdk.passes.rows.row_order import Order, order_of


class RowDraft(Detached):
    """Drafts what is common to all masked rows.

    Attributes:
        results: Value of the graph → what was drafted to take its place, of the same shape.
        fed: (node, input, value): what a node that stays is to read in place of a count.
    """

    def __init__(self, stem: str) -> None:
        super().__init__(stem)
        self.results: dict[ir.Value, ir.Value] = {}
        self.fed: list[tuple[ir.Node, int, ir.Value]] = []
        self._orders: dict[Mask, Order] = {}

    def order(self, mask: Mask) -> Order:
        """Return which rows ``mask`` keeps; drafted once."""
        mask = mask.bare
        if mask not in self._orders:
            self._orders[mask] = order_of(self, self.truth(mask), mask.size)
        return self._orders[mask]

    def truth(self, mask: Mask) -> ir.Value:
        """Return the mask as booleans, [N]."""
        root = mask.root
        if root.dtype != ir.DataType.BOOL:
            kind = ir.DataType.BOOL
            root = self.op("Cast", root, dtype=kind, shape=mask.dims, to=kind.value)
        return self.reshaped(root, [mask.size])

    def reshaped(self, value: ir.Value, dims: Sequence[int]) -> ir.Value:
        """Return ``value`` in this shape; itself where that is its shape."""
        if fixed_shape(value) == tuple(dims):
            return value
        return self.op("Reshape", value, self.constant(dims, np.int64), shape=dims)

    def compact(self, rows: Rows, fill: np.ndarray | None = None) -> ir.Value:
        """Draft the K rows of ``rows`` in front, and ``fill`` (or zeros) behind; N rows in all."""
        order, value, shape = self.order(rows.mask), rows.value, fixed_shape(rows.value)
        assert shape is not None
        assert value.dtype is not None
        moved = self.op("Gather", value, order.rows, shape=shape, axis=rows.axis)
        dims = [1] * len(shape)
        dims[rows.axis] = rows.mask.size
        live = self.reshaped(order.live, dims)
        behind = self.constant(0 if fill is None else fill, value.dtype.numpy())
        return self.op("Where", live, moved, behind, dtype=value.dtype, shape=shape)

    def number(self, fact: Linear, like: ir.Value) -> ir.Value:
        """Draft the numbers that ``fact`` stands for, in the dtype of ``like``."""
        if not fact.varies:
            return like
        kind, shape = like.dtype, list(fact.constant.shape)
        assert kind is not None
        if not fact.factor.any():
            return self.constant(fact.constant, kind.numpy())
        count = self.order(fact.mask).count
        if kind != count.dtype:
            count = self.op("Cast", count, dtype=kind, shape=[1], to=kind.value)
        made = self.reshaped(count, shape) if fact.constant.size == 1 else count
        if (fact.factor != 1).any():
            by = self.constant(fact.factor, kind.numpy())
            made = self.op("Mul", made, by, shape=shape)
        if fact.constant.any():
            more = self.constant(fact.constant, kind.numpy())
            made = self.op("Add", made, more, shape=shape)
        return made
