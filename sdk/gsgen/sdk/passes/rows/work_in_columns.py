"""Long, narrow tensors as columns."""

__all__ = ["WorkInColumns"]

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Any, ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import SAFE_WIDTH, ErrorBudget, Rewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import fixed_shape
from gsgen.sdk.passes.rows.column_rules import Columns, Emit, columns_of, handles

# A launch costs as much as some ten thousand rows; below this, fewer nodes are better.
_FEWEST_ROWS = 1 << 16
_WIDEST = 16
# Nanoseconds an element, measured with ONNX Runtime 1.31 on one core: what counts is how they
# compare. Joining and splitting narrow rows moves four bytes at a time.
_PLAIN, _SPREAD, _JOIN, _CUT, _REDUCE, _EXPAND = 1.2, 3.2, 4.0, 2.0, 2.0, 5.5
_FREE = ("Reshape", "Squeeze", "Unsqueeze")
_WORTH = 0.85


class WorkInColumns(Rewrite):
    """Compute with the columns of long, narrow tensors, each a tensor of its own.

    What makes a covariance from a rotation and a scale works on rows of three, four and nine
    numbers: it joins them, spreads a factor over each row, sums over the row, and takes parts of it.
    Of a million rows, each of these steps moves four bytes at a time. The same products and sums of
    whole columns run at the speed of memory, and most steps vanish::

        ReduceSum(Concat(a, b, c) · spread(s), axis 1)   →   a · s + b · s + c · s

    A group of nodes that hang together is rewritten where that is reckoned to take at most 85 % of
    the time, from costs an element that were measured; and for 65,536 rows and more, because it takes
    more nodes, each of which costs a launch on a GPU.
    """

    name: ClassVar[str] = "work-in-columns"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=2e-6)

    def rewrite(self, model: ir.Model) -> None:
        """Rewrite every group of the main graph that is worth it."""
        for group in _groups(model.graph):
            planned = _Plan(group)
            if planned.after() <= _WORTH * planned.before():
                for node in group.nodes:
                    self.note(node)
                planned.build()


@dataclass
class _Group:
    """Nodes that work on tensors of the same number of rows, and hang together."""

    rows: int
    nodes: list[ir.Node] = field(default_factory=list)


def _groups(graph: ir.Graph) -> Iterator[_Group]:
    """Yield groups of narrow nodes that depend on an input, each in the order of the graph."""
    varying = {value for value in graph.inputs if value.name not in graph.initializers}
    owner: dict[ir.Value, _Group] = {}
    groups: list[_Group] = []
    for node in graph:
        if not varying.intersection(value for value in node.inputs if value is not None):
            continue
        varying.update(node.outputs)
        rows = _rows(node)
        if rows is None:
            continue
        met = {
            id(owner[v]): owner[v]
            for v in node.inputs
            if v in owner and owner[v].rows == rows
        }
        merged = _Group(rows)
        for other in met.values():
            merged.nodes += other.nodes
            groups.remove(other)
        merged.nodes.append(node)
        groups.append(merged)
        owner |= {value: merged for one in merged.nodes for value in one.outputs}
    order = {node: index for index, node in enumerate(graph)}
    for group in groups:
        group.nodes.sort(key=order.__getitem__)
        yield group


def _rows(node: ir.Node) -> int | None:
    """Return how many rows ``node`` works on; None where it is not narrow, or of another kind."""
    shapes = [fixed_shape(value) for value in node.outputs]
    rows = {shape[0] if shape else 0 for shape in shapes}
    if None in shapes or len(rows) != 1:
        return None
    (count,) = rows
    narrow = all(shape and prod(shape[1:]) <= _WIDEST for shape in shapes)
    return count if count >= _FEWEST_ROWS and narrow and handles(node, count) else None


class _Plan:
    """What rewriting a group would cost, and how it is done."""

    def __init__(self, group: _Group) -> None:
        self.rows, self.nodes = group.rows, group.nodes
        inside = set(self.nodes)
        self.inputs = {node: list(node.inputs) for node in self.nodes}
        self.made = {value for node in self.nodes for value in node.outputs}
        # What others read has to be put together again.
        self.read = {
            value
            for value in self.made
            if value.is_graph_output()
            or any(user not in inside for user in value.consumers())
        }

    def before(self) -> float:
        """Nanoseconds a row, as the graph is."""
        return sum(_cost(node, self.rows) for node in self.nodes)

    def after(self) -> float:
        """Nanoseconds a row, in columns."""
        seen: dict[Hashable, int] = {}
        cut: set[ir.Value] = set()

        def emit(kind: str, operands: Sequence[Any], attributes: dict[str, Any]) -> int:
            key = (kind, tuple(operands), tuple(sorted(attributes.items())))
            return seen.setdefault(key, len(seen))

        def leaf(value: ir.Value) -> Columns:
            cut.add(value)
            shape = fixed_shape(value) or ()
            names = [(value.name, index) for index in range(prod(shape[1:]))]
            array = np.empty(len(names), object)
            array[:] = names
            return array.reshape(shape[1:])

        self._run(lambda _: (emit, leaf), lambda *_: None)
        widths = [_width(value) for value in cut if value.producer() is not None]
        # A target with narrow bindings joins more than seven columns twice.
        wide = [_width(value) for value in self.read if _width(value) > 1]
        joined = [width * (2 if width > SAFE_WIDTH else 1) for width in wide]
        return (
            _PLAIN * len(seen)
            + _CUT * sum(w for w in widths if w > 1)
            + _JOIN * sum(joined)
        )

    def build(self) -> None:
        """Write the columns, and put together what others read."""
        seen: dict[Hashable, ir.Value] = {}

        def writers(write: InsertionPoint) -> tuple[Emit, Callable[[ir.Value], Columns]]:
            def emit(
                kind: str, operands: Sequence[Any], attributes: dict[str, Any]
            ) -> ir.Value:
                key = (kind, tuple(operands), tuple(sorted(attributes.items())))
                if key not in seen:
                    seen[key] = _written(write, kind, operands, attributes)
                return seen[key]

            return emit, lambda value: _cut(write, value, self.rows)

        def finish(write: InsertionPoint, node: ir.Node, columns: list[Columns]) -> None:
            for value, made in zip(node.outputs, columns, strict=True):
                if value in self.read:
                    whole = _joined(write, made, value, self.rows)
                    ir.convenience.replace_all_uses_with(
                        value, whole, replace_graph_outputs=True
                    )
                    if value.name is not None and whole.is_graph_output():
                        whole.name, value.name = value.name, f"{value.name}_rows"

        self._run(writers, finish)
        for node in reversed(self.nodes):
            assert isinstance(node.graph, ir.Graph)
            node.graph.remove(node, safe=True)

    def _run(self, writers: Callable[..., Any], finish: Callable[..., None]) -> None:
        known: dict[ir.Value, Columns] = {}
        for node in self.nodes:
            write = InsertionPoint(node)
            emit, leaf = writers(write)

            def look(
                value: ir.Value, leaf: Callable[[ir.Value], Columns] = leaf
            ) -> Columns:
                if value not in known:
                    known[value] = leaf(value)
                return known[value]

            columns = columns_of(node, self.inputs[node], self.rows, look, emit)
            known.update(zip(node.outputs, columns, strict=True))
            finish(write, node, columns)


def _width(value: ir.Value) -> int:
    return prod((fixed_shape(value) or (1,))[1:])


def _cost(node: ir.Node, rows: int) -> float:
    """Return what ``node`` costs as it is, in nanoseconds a row."""
    made = sum(_width(value) for value in node.outputs)
    first = node.inputs[0]
    taken = (
        _width(first)
        if first is not None and (fixed_shape(first) or (0,))[0] == rows
        else 1
    )
    if is_op(node, *_FREE):
        return 0.0
    if node.op_type.startswith("Reduce"):
        return _REDUCE * taken
    if is_op(node, "Concat", "Transpose"):
        return _JOIN * made
    if is_op(node, "Slice", "Gather", "Split"):
        return _CUT * made
    if is_op(node, "Expand"):
        return _EXPAND * made
    shapes = [fixed_shape(value) for value in node.inputs if value is not None]
    long = [shape for shape in shapes if shape and shape[0] == rows]
    spread = any(prod(shape[1:]) != made for shape in long)
    return (_SPREAD if spread else _PLAIN) * made


def _written(
    write: InsertionPoint, kind: str, operands: Sequence[Any], attributes: dict[str, Any]
) -> ir.Value:
    values = [
        write.constant(np.asarray(one), "number") if isinstance(one, np.generic) else one
        for one in operands
    ]
    tests = kind in (
        "Equal",
        "Greater",
        "GreaterOrEqual",
        "Less",
        "LessOrEqual",
        "Not",
        "And",
        "Or",
    )
    dtype = ir.DataType.BOOL if tests else None
    if kind == "Cast":
        dtype = ir.DataType(attributes["to"])
    elif kind == "Where":
        dtype = values[1].dtype
    return write.op(kind, *values, dtype=dtype, **attributes)


def _cut(write: InsertionPoint, value: ir.Value, rows: int) -> Columns:
    """Return the columns [rows] of a tensor that is not made here.

    They have one axis: of two axes, ONNX Runtime spreads a single number row by row.
    """
    shape = fixed_shape(value)
    assert shape is not None
    width = prod(shape[1:])
    array = np.empty(width, object)
    flat = (
        value
        if shape == (rows, width)
        else write.op("Reshape", value, write.whole(rows, width))
    )
    flat.shape = ir.Shape([rows, width])
    cut = (
        [flat]
        if width == 1
        else write.ops("Split", width, flat, write.whole(*[1] * width), axis=1)
    )
    array[:] = [write.op("Reshape", one, write.whole(rows)) for one in cut]
    return array.reshape(shape[1:])


def _joined(
    write: InsertionPoint, columns: Columns, value: ir.Value, rows: int
) -> ir.Value:
    """Return ``columns`` as a tensor of the shape of ``value``."""
    shape = fixed_shape(value)
    assert shape is not None
    parts = _rejoined(write, list(columns.reshape(-1)), rows)
    whole = parts[0] if len(parts) == 1 else write.op("Concat", *parts, axis=1)
    made = write.op("Reshape", whole, write.whole(*shape))
    made.type, made.shape = value.type, value.shape
    return made


def _rejoined(write: InsertionPoint, columns: list[ir.Value], rows: int) -> list[ir.Value]:
    """Return tensors [rows, …] that are ``columns`` side by side.

    What was cut into columns that stand side by side again is put back whole.
    """
    made: list[ir.Value] = []
    while columns:
        run, whole = _run_of(columns)
        made.append(whole or write.op("Reshape", columns[0], write.whole(rows, 1)))
        columns = columns[run:]
    return made


def _run_of(columns: list[ir.Value]) -> tuple[int, ir.Value | None]:
    """Return how many columns from the first on are all that one Split returns, and what it cut."""
    sources = [_uncut(column) for column in columns]
    maker = sources[0].producer() if sources[0] is not None else None
    if maker is None or not is_op(maker, "Split"):
        return 1, None
    cut = list(maker.outputs)
    return (len(cut), maker.inputs[0]) if sources[: len(cut)] == cut else (1, None)


def _uncut(column: ir.Value) -> ir.Value | None:
    maker = column.producer()
    return maker.inputs[0] if maker is not None and is_op(maker, "Reshape") else None
