"""Creates replacement nodes for row masks, which join the graph only if all can be created."""

__all__ = ["RowDraft"]

from collections.abc import Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.detached_graph import DetachedGraph
from gsgen.sdk.passes.framework.value_facts import fixed_shape, numpy_dtype, required
from gsgen.sdk.passes.rows.row_facts import Linear, Mask, Rows
from gsgen.sdk.passes.rows.row_order import RowOrder, draft_order


class RowDraft(DetachedGraph):
    """Creates graph nodes that compute row masks, row orders and compacted rows.

    Attributes:
        results: Value of the graph → its drafted replacement of the same shape.
        input_replacements: (node, input index, value) for nodes that stay and read a count.
    """

    def __init__(self, stem: str) -> None:
        super().__init__(stem)
        self.results: dict[ir.Value, ir.Value] = {}
        self.input_replacements: list[tuple[ir.Node, int, ir.Value]] = []
        self.fixed_counts: dict[Mask, int] = {}  # K, for masks of which the graph says it
        self._order_by_mask: dict[Mask, RowOrder] = {}

    def order(self, mask: Mask) -> RowOrder:
        """Return a row order that puts the rows selected by a mask first; created once per mask."""
        mask = mask.without_repeats
        if mask not in self._order_by_mask:
            self._order_by_mask[mask] = draft_order(self, self.boolean_mask(mask), mask.size)
        return self._order_by_mask[mask]

    def boolean_mask(self, mask: Mask) -> ir.Value:
        """Create the graph nodes that compute a row mask as a boolean vector [N]."""
        root = mask.root
        if root.dtype != ir.DataType.BOOL:
            kind = ir.DataType.BOOL
            root = self.op("Cast", root, dtype=kind, shape=mask.dims, to=kind.value)
        return self.reshaped(root, [mask.size])

    def reshaped(self, value: ir.Value, dims: Sequence[int]) -> ir.Value:
        """Create a Reshape of a graph value, unless the value already has the requested shape."""
        if fixed_shape(value) == tuple(dims):
            return value
        return self.op("Reshape", value, self.constant(dims, np.int64), shape=dims)

    def compact(self, rows: Rows, fill_row: np.ndarray | None = None) -> ir.Value:
        """Create N rows: first the K rows that a mask selects, then filler rows (default zeros)."""
        order, value, shape = self.order(rows.mask), rows.value, required(fixed_shape(rows.value))
        compacted_value = self.op("Gather", value, order.rows, shape=shape, axis=rows.axis)
        dims = [1] * len(shape)
        dims[rows.axis] = rows.mask.size
        live = self.reshaped(order.live, dims)
        fill_value = self.constant(0 if fill_row is None else fill_row, numpy_dtype(value))
        return self.op("Where", live, compacted_value, fill_value, dtype=value.dtype, shape=shape)

    def number(self, fact: Linear, like: ir.Value) -> ir.Value:
        """Create the nodes that compute integers a + b · K from the number K of selected rows."""
        if not fact.varies:
            return like
        kind, shape = required(like.dtype), list(fact.constant.shape)
        fixed_count = self.fixed_counts.get(fact.mask.without_repeats, 0)
        if fixed_count or not fact.factor.any():
            return self.constant(fact.constant + fact.factor * fixed_count, kind.numpy())
        count = self.order(fact.mask).count
        if kind != count.dtype:
            count = self.op("Cast", count, dtype=kind, shape=[1], to=kind.value)
        number = self.reshaped(count, shape) if fact.constant.size == 1 else count
        if (fact.factor != 1).any():
            factor = self.constant(fact.factor, kind.numpy())
            number = self.op("Mul", number, factor, shape=shape)
        if fact.constant.any():
            offset = self.constant(fact.constant, kind.numpy())
            number = self.op("Add", number, offset, shape=shape)
        return number
