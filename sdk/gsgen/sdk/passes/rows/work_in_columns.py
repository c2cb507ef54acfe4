"""Rewrites arithmetic on long, narrow tensors to work column by column."""

__all__ = ["RewriteRowsToColumns"]

from collections.abc import Callable, Hashable, Sequence
from math import prod
from typing import Any

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import SAFE_TENSOR_COUNT, ErrorBudget, Rewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import fixed_shape, required
from gsgen.sdk.passes.rows.column_rules import Columns, EmitNode, columns_of, works_on_columns
from gsgen.sdk.passes.rows.row_groups import RowGroup, row_groups

# A kernel launch costs as much as some ten thousand rows; below this, fewer nodes are faster.
_ROWS = range(1 << 16, 1 << 62)
# Nanoseconds per element, measured with ONNX Runtime 1.31 on one core; only their ratios matter.
# Joining and splitting narrow rows moves four bytes at a time.
_ELEMENTWISE_COST, _BROADCAST_COST, _JOIN_COST, _SPLIT_COST, _REDUCE_COST, _EXPAND_COST = (
    1.2, 3.2, 4.0, 2.0, 2.0, 5.5,
)  # fmt: skip
_COPY_OPERATORS = ("Reshape", "Squeeze", "Unsqueeze")
_MAX_COST_RATIO = 0.85


class RewriteRowsToColumns(Rewrite):
    """Compute the columns of long, narrow tensors as separate tensors.

    A covariance is computed from a rotation and a scale in rows of three, four and nine numbers:
    they are joined, multiplied by a broadcast factor, summed and split. With a million rows, each
    of these steps moves four bytes at a time. The same products and sums of whole columns run at
    the speed of memory, and most steps vanish::

        ReduceSum(Concat(a, b, c) · broadcast(s), axis 1)   →   a · s + b · s + c · s

    A group of connected nodes is rewritten if the measured costs per element predict at most 85 %
    of the time, and from 65,536 rows on: the rewrite adds nodes, and each costs a launch on a GPU.
    """

    name = "work-in-columns"
    exactness = ErrorBudget(relative=2e-6)

    def rewrite(self, model: ir.Model) -> None:
        """Compute groups of nodes column by column where this is predicted to take less time."""
        for group in row_groups(model.graph, _ROWS, works_on_columns):
            column_plan = _ColumnPlan(group)
            if column_plan.cost_after() <= _MAX_COST_RATIO * column_plan.cost_before():
                for node in group.nodes:
                    self.note(node)
                column_plan.build()


class _ColumnPlan:
    """A plan to compute nodes column by column, with the predicted times before and after."""

    def __init__(self, group: RowGroup) -> None:
        self.rows, self.nodes = group.rows, group.nodes
        inner_nodes = set(self.nodes)
        self.inputs = {node: list(node.inputs) for node in self.nodes}
        self.results = {value for node in self.nodes for value in node.outputs}
        # Results that nodes outside the group read must be joined again.
        self.external_results = {
            value
            for value in self.results
            if value.is_graph_output()
            or any(consumer not in inner_nodes for consumer in value.consumers())
        }

    def cost_before(self) -> float:
        """Return the predicted time of a group's nodes as they are, in nanoseconds per row."""
        return sum(_operator_cost(node, self.rows) for node in self.nodes)

    def cost_after(self) -> float:
        """Return the predicted time of a group's nodes column by column, in nanoseconds per row."""
        numbers: dict[Hashable, int] = {}
        split_values: set[ir.Value] = set()

        def emit(kind: str, operands: Sequence[Any], attributes: dict[str, Any]) -> int:
            key = (kind, tuple(operands), tuple(sorted(attributes.items())))
            return numbers.setdefault(key, len(numbers))

        def leaf(value: ir.Value) -> Columns:
            split_values.add(value)
            shape = fixed_shape(value) or ()
            names = [(value.name, index) for index in range(prod(shape[1:]))]
            array = np.empty(len(names), object)
            array[:] = names
            return array.reshape(shape[1:])

        self._run(lambda _: (emit, leaf), lambda *_: None)
        widths = [_row_width(value) for value in split_values if value.producer() is not None]
        # A target with few bindings joins more than seven columns in two steps.
        joined_widths = [
            _row_width(value) for value in self.external_results if _row_width(value) > 1
        ]
        total_widths = [width * (2 if width > SAFE_TENSOR_COUNT else 1) for width in joined_widths]
        return (
            _ELEMENTWISE_COST * len(numbers)
            + _SPLIT_COST * sum(w for w in widths if w > 1)
            + _JOIN_COST * sum(total_widths)
        )

    def build(self) -> None:
        """Replace connected nodes by nodes on single columns; join columns read elsewhere."""
        columns_by_key: dict[Hashable, ir.Value] = {}

        def writers(write: InsertionPoint) -> tuple[EmitNode, Callable[[ir.Value], Columns]]:
            def emit(kind: str, operands: Sequence[Any], attributes: dict[str, Any]) -> ir.Value:
                key = (kind, tuple(operands), tuple(sorted(attributes.items())))
                if key not in columns_by_key:
                    columns_by_key[key] = _write_operator(write, kind, operands, attributes)
                return columns_by_key[key]

            return emit, lambda value: _split_columns(write, value, self.rows)

        def finish(write: InsertionPoint, node: ir.Node, columns: list[Columns]) -> None:
            for value, value_columns in zip(node.outputs, columns, strict=True):
                if value in self.external_results:
                    joined_tensor = _join_columns(write, value_columns, value, self.rows)
                    ir.convenience.replace_all_uses_with(
                        value, joined_tensor, replace_graph_outputs=True
                    )
                    if value.name is not None and joined_tensor.is_graph_output():
                        joined_tensor.name, value.name = value.name, f"{value.name}_rows"

        self._run(writers, finish)
        for node in reversed(self.nodes):
            assert isinstance(node.graph, ir.Graph)
            node.graph.remove(node, safe=True)

    def _run(self, writers: Callable[..., Any], finish: Callable[..., None]) -> None:
        known: dict[ir.Value, Columns] = {}
        for node in self.nodes:
            write = InsertionPoint(node)
            emit, leaf = writers(write)

            def lookup(value: ir.Value, leaf: Callable[[ir.Value], Columns] = leaf) -> Columns:
                if value not in known:
                    known[value] = leaf(value)
                return known[value]

            columns = columns_of(node, self.inputs[node], self.rows, lookup, emit)
            known.update(zip(node.outputs, columns, strict=True))
            finish(write, node, columns)


def _row_width(value: ir.Value) -> int:
    return prod((fixed_shape(value) or (1,))[1:])


def _operator_cost(node: ir.Node, rows: int) -> float:
    """Return the predicted execution time of a node, in nanoseconds per row."""
    result_width = sum(_row_width(value) for value in node.outputs)
    first = node.inputs[0]
    input_width = (
        _row_width(first) if first is not None and (fixed_shape(first) or (0,))[0] == rows else 1
    )
    if is_op(node, *_COPY_OPERATORS):
        return 0.0
    if node.op_type.startswith("Reduce"):
        return _REDUCE_COST * input_width
    if is_op(node, "Concat", "Transpose"):
        return _JOIN_COST * result_width
    if is_op(node, "Slice", "Gather", "Split"):
        return _SPLIT_COST * result_width
    if is_op(node, "Expand"):
        return _EXPAND_COST * result_width
    shapes = [fixed_shape(value) for value in node.inputs if value is not None]
    long_shapes = [shape for shape in shapes if shape and shape[0] == rows]
    does_broadcast = any(prod(shape[1:]) != result_width for shape in long_shapes)
    return (_BROADCAST_COST if does_broadcast else _ELEMENTWISE_COST) * result_width


def _write_operator(
    write: InsertionPoint, kind: str, operands: Sequence[Any], attributes: dict[str, Any]
) -> ir.Value:
    values = [
        write.constant(np.asarray(operand), "number")
        if isinstance(operand, np.generic)
        else operand
        for operand in operands
    ]
    is_boolean = kind in (
        "Equal",
        "Greater",
        "GreaterOrEqual",
        "Less",
        "LessOrEqual",
        "Not",
        "And",
        "Or",
    )
    dtype = ir.DataType.BOOL if is_boolean else None
    if kind == "Cast":
        dtype = ir.DataType(attributes["to"])
    elif kind == "Where":
        dtype = values[1].dtype
    return write.op(kind, *values, dtype=dtype, **attributes)


def _split_columns(write: InsertionPoint, value: ir.Value, rows: int) -> Columns:
    """Split a tensor computed outside the rewritten nodes into columns of shape [rows].

    Columns have one axis, because ONNX Runtime broadcasts a number over two axes row by row.
    """
    shape = required(fixed_shape(value))
    width = prod(shape[1:])
    array = np.empty(width, object)
    flat = value if shape == (rows, width) else write.op("Reshape", value, write.int64(rows, width))
    flat.shape = ir.Shape([rows, width])
    parts = (
        [flat] if width == 1 else write.ops("Split", width, flat, write.int64(*[1] * width), axis=1)
    )
    array[:] = [write.op("Reshape", part, write.int64(rows)) for part in parts]
    return array.reshape(shape[1:])


def _join_columns(write: InsertionPoint, columns: Columns, value: ir.Value, rows: int) -> ir.Value:
    """Join separate columns to a tensor with the shape of a graph value."""
    shape = required(fixed_shape(value))
    parts = _restored_parts(write, list(columns.reshape(-1)), rows)
    joined_tensor = parts[0] if len(parts) == 1 else write.op("Concat", *parts, axis=1)
    tensor = write.op("Reshape", joined_tensor, write.int64(*shape))
    tensor.type, tensor.shape = value.type, value.shape
    return tensor


def _restored_parts(write: InsertionPoint, columns: list[ir.Value], rows: int) -> list[ir.Value]:
    """Return tensors [rows, …] that contain given columns in order.

    Columns that are all outputs of one Split, in order, are replaced by the input of the Split.
    """
    parts: list[ir.Value] = []
    while columns:
        run, joined_tensor = _split_column_run(columns)
        parts.append(joined_tensor or write.op("Reshape", columns[0], write.int64(rows, 1)))
        columns = columns[run:]
    return parts


def _split_column_run(columns: list[ir.Value]) -> tuple[int, ir.Value | None]:
    """Return how many leading columns are outputs of the same Split, and the Split's input."""
    sources = [_source_before_reshape(column) for column in columns]
    source_node = sources[0].producer() if sources[0] is not None else None
    if source_node is None or not is_op(source_node, "Split"):
        return 1, None
    split_outputs = list(source_node.outputs)
    return (
        (len(split_outputs), source_node.inputs[0])
        if sources[: len(split_outputs)] == split_outputs
        else (1, None)
    )


def _source_before_reshape(column: ir.Value) -> ir.Value | None:
    source_node = column.producer()
    return (
        source_node.inputs[0] if source_node is not None and is_op(source_node, "Reshape") else None
    )
