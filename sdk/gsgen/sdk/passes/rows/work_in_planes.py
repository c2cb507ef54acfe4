"""Rewrites arithmetic on narrow rows to work on planes, whose last axis counts the rows."""

__all__ = ["RewriteRowsToPlanes"]

from collections.abc import Sequence
from math import prod

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, Rewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import (
    attribute_values,
    constant_of,
    fixed_shape,
    int_attribute,
    required,
)
from gsgen.sdk.passes.rows.column_rules import (
    ELEMENTWISE_OPERATORS,
    reduction_axes,
    works_on_columns,
)
from gsgen.sdk.passes.rows.row_groups import RowGroup, row_groups

# Fewer rows cost less than the launches that are added; more leave the cache, and gain nothing.
_ROWS = range(1 << 12, 1 << 15)
_MAX_COST_RATIO = 0.75
# Nanoseconds, measured with ONNX Runtime 1.31 on one core; only their ratios matter. An element; a
# run of elements that one step of a broadcast, a choice or a copy covers; a product of two matrices.
_ELEMENT_COST, _BROADCAST_COST, _CHOICE_COST, _COPY_COST, _PRODUCT_COST = (
    0.45,
    11.0,
    29.0,
    3.5,
    85.0,
)
_TRANSPOSE_COST, _STRIDED_REDUCE_COST, _PLANE_COPY_COST = 0.25, 5.0, 0.15
# A node costs as much as a launch on a GPU, even where it computes little.
_NODE_COST = 3000.0
_MAX_PRODUCT_TERMS = 4

_MORE_ELEMENTWISE_OPERATORS = frozenset(
    {"Acos", "Asin", "Atan", "BitwiseAnd", "BitwiseXor", "Erf", "Mod", "Pow", "Softplus", "Tan"}
)
_RESHAPE_OPERATORS = ("Reshape", "Squeeze", "Unsqueeze")


class RewriteRowsToPlanes(Rewrite):
    """Compute narrow tensors of some thousand rows with the axis of the rows last.

    A rotation, a quaternion or a covariance for each Gaussian is a tensor [N, 3, 3], [N, 4] or
    [N, 6]. Where such rows are broadcast, summed or multiplied as matrices, ONNX Runtime's CPU
    kernels do three or four numbers at a time. With the rows along the last axis, each step does
    N numbers, and a product of small matrices is a sum of a few products of planes::

        Mul(R [N, 3, 3], s [N, 1, 3])   →   Mul(Rᵀ [3, 3, N], sᵀ [1, 3, N])
        MatMul(A, B)                    →   Σₖ Aᵀ[:, k, None] · Bᵀ[None, k]

    Each operator stays one, so that a GPU launches about as often. A group of connected nodes is
    rewritten if the measured costs predict at most three quarters of the time, from 4,096 to 32,767
    rows; from 65,536 on, ``work-in-columns`` computes single columns.
    """

    name = "work-in-planes"
    exactness = ErrorBudget(relative=2e-6)

    def rewrite(self, model: ir.Model) -> None:
        """Compute groups of nodes in planes where this is predicted to take less time."""
        for group in row_groups(model.graph, _ROWS, _works_in_planes):
            plan = _PlanePlan(group)
            if plan.cost_after() <= _MAX_COST_RATIO * plan.cost_before():
                for node in group.nodes:
                    self.note(node)
                plan.build()


def _works_in_planes(node: ir.Node, rows: int) -> bool:
    """Return whether a node on tensors of many rows can be computed with the rows last."""
    shape = required(fixed_shape(node.outputs[0]))
    if _is_elementwise(node):
        return all(value is None or _is_operand(value, shape, rows) for value in node.inputs)
    if is_op(node, "MatMul"):
        return _are_small_matrices(node, rows)
    first = fixed_shape(node.inputs[0]) if node.inputs else None
    if not first or first[0] != rows or (is_op(node, "Expand") and len(first) != len(shape)):
        return False
    if node.op_type.startswith("Reduce"):
        axes = reduction_axes(node, len(first))
        return bool(axes) and 0 not in axes
    return works_on_columns(node, rows)


def _is_elementwise(node: ir.Node) -> bool:
    return is_op(node, *ELEMENTWISE_OPERATORS, *_MORE_ELEMENTWISE_OPERATORS)


def _is_operand(value: ir.Value, shape: tuple[int, ...], rows: int) -> bool:
    """Return whether a value can be an operand: rows, or the same numbers for all rows."""
    operand = fixed_shape(value)
    if operand is None or len(operand) > len(shape):
        return False
    return len(operand) < len(shape) or operand[0] in (1, rows)


def _are_small_matrices(node: ir.Node, rows: int) -> bool:
    a, b = (fixed_shape(value) for value in node.inputs)
    if a is None or b is None or len(a) != 3 or len(b) != 3 or node.inputs[0] is None:
        return False
    is_float = node.inputs[0].dtype == ir.DataType.FLOAT
    return is_float and a[0] == b[0] == rows and a[2] <= _MAX_PRODUCT_TERMS


class _PlanePlan:
    """A plan to compute nodes in planes, with the predicted times before and after."""

    def __init__(self, group: RowGroup) -> None:
        self.rows, self.nodes = group.rows, group.nodes
        inner_nodes = set(self.nodes)
        self.results = {value for node in self.nodes for value in node.outputs}
        # Results that nodes outside the group read become rows again.
        self.external_results = [
            value
            for node in self.nodes
            for value in node.outputs
            if value.is_graph_output() or not inner_nodes.issuperset(value.consumers())
        ]
        self._planes: dict[ir.Value, ir.Value] = {}

    def cost_before(self) -> float:
        """Return the predicted time of a group's nodes as they are, in nanoseconds per row."""
        launches = _NODE_COST * len(self.nodes) / self.rows
        return launches + sum(self._row_cost(node) for node in self.nodes)

    def cost_after(self) -> float:
        """Return the predicted time of a group's nodes in planes, in nanoseconds per row."""
        borders = {
            value
            for node in self.nodes
            for value in node.inputs
            if value is not None and value not in self.results and self._is_rows(value)
        }
        # Weights are transposed when the model is loaded.
        computed = [value for value in borders if value.producer() is not None]
        widths = [self._width(value) for value in (*computed, *self.external_results)]
        transposed = [width for width in widths if width > 1]
        products = [node for node in self.nodes if is_op(node, "MatMul")]
        added = sum(2 * required(fixed_shape(node.inputs[0]))[2] for node in products)
        launches = _NODE_COST * (len(self.nodes) + added + len(transposed)) / self.rows
        return (
            launches
            + _TRANSPOSE_COST * sum(transposed)
            + sum(self._plane_cost(node) for node in self.nodes)
        )

    def build(self) -> None:
        """Replace connected nodes by nodes on planes; results that others read become rows."""
        rows_again: list[tuple[ir.Value, ir.Value]] = []
        for node in self.nodes:
            write = InsertionPoint(node)
            for value, plane in zip(node.outputs, self._write(write, node), strict=True):
                shape = required(fixed_shape(value))
                plane.type, plane.shape = value.type, ir.Shape((*shape[1:], self.rows))
                self._planes[value] = plane
                if value in self.external_results:
                    rows_again.append((value, self._write_rows(write, plane, value)))
        for value, rows in rows_again:
            ir.convenience.replace_all_uses_with(value, rows, replace_graph_outputs=True)
            if value.name is not None and rows.is_graph_output():
                rows.name, value.name = value.name, f"{value.name}_rows"
        for node in reversed(self.nodes):
            assert isinstance(node.graph, ir.Graph)
            node.graph.remove(node, safe=True)

    def _is_rows(self, value: ir.Value) -> bool:
        shape = fixed_shape(value)
        return bool(shape) and shape is not None and shape[0] == self.rows

    @staticmethod
    def _width(value: ir.Value) -> int:
        return prod(required(fixed_shape(value))[1:])

    # ---- Predicted times, in nanoseconds per row

    def _row_cost(self, node: ir.Node) -> float:
        width = sum(self._width(value) for value in node.outputs)
        if is_op(node, *_RESHAPE_OPERATORS):
            return 0.0
        if is_op(node, "MatMul"):
            return _PRODUCT_COST
        if node.op_type.startswith("Reduce"):
            shape = required(fixed_shape(node.inputs[0]))
            is_last = len(shape) - 1 in reduction_axes(node, len(shape))
            cost = _ELEMENT_COST if is_last else _STRIDED_REDUCE_COST
            return cost * prod(shape[1:])
        if _is_elementwise(node):
            run = _broadcast_run(node)
            step = _CHOICE_COST if is_op(node, "Where") else _BROADCAST_COST
            return _ELEMENT_COST * width + (step * width / run if run < width else 0.0)
        return _COPY_COST * len([value for value in node.outputs if value.uses()])

    def _plane_cost(self, node: ir.Node) -> float:
        width = sum(self._width(value) for value in node.outputs)
        if is_op(node, *_RESHAPE_OPERATORS):
            return 0.0
        if is_op(node, "MatMul"):
            return 2 * _ELEMENT_COST * width * required(fixed_shape(node.inputs[0]))[2]
        if node.op_type.startswith("Reduce"):
            return _ELEMENT_COST * self._width(required(node.inputs[0]))
        return (_ELEMENT_COST if _is_elementwise(node) else _PLANE_COPY_COST) * width

    # ---- Nodes

    def _write(self, write: InsertionPoint, node: ir.Node) -> Sequence[ir.Value]:
        """Write the nodes that compute the planes of a node's outputs."""
        result = node.outputs[0]
        shape, attributes = required(fixed_shape(result)), attribute_values(node)
        if _is_elementwise(node):
            operands = [self._operand(write, value, shape) for value in node.inputs]
            return [write.op(node.op_type, *operands, dtype=result.dtype, **attributes)]
        if is_op(node, "MatMul"):
            return [self._write_product(write, node)]
        first = self._plane(write, required(node.inputs[0]))
        rank = len(required(fixed_shape(node.inputs[0])))
        if is_op(node, *_RESHAPE_OPERATORS):
            return [write.op("Reshape", first, write.int64(*shape[1:], self.rows))]
        if is_op(node, "Expand"):
            return [write.op("Expand", first, write.int64(*shape[1:], self.rows))]
        if node.op_type.startswith("Reduce"):
            axes = [axis - 1 for axis in reduction_axes(node, rank)]
            if "axes" in attributes:
                return [write.op(node.op_type, first, **attributes | {"axes": axes})]
            return [write.op(node.op_type, first, write.int64(*axes), **attributes)]
        if is_op(node, "Transpose"):
            perm = [axis - 1 for axis in attributes["perm"][1:]]
            return [write.op("Transpose", first, perm=[*perm, rank - 1])]
        if is_op(node, "Slice"):
            starts, ends, sliced, *steps = node.inputs[1:]
            moved = np.mod(required(constant_of(sliced)), rank) - 1
            return [write.op("Slice", first, starts, ends, write.constant(moved, "axes"), *steps)]
        attributes["axis"] = int_attribute(node, "axis", 0) % rank - 1
        if is_op(node, "Split"):
            return write.ops("Split", len(node.outputs), first, *node.inputs[1:], **attributes)
        if is_op(node, "Concat"):
            others = [self._plane(write, required(value)) for value in node.inputs[1:]]
            return [write.op("Concat", first, *others, **attributes)]
        return [write.op("Gather", first, node.inputs[1], **attributes)]

    def _write_product(self, write: InsertionPoint, node: ir.Node) -> ir.Value:
        """Write the product of matrices [a, k] and [k, b] as a sum of k products of planes."""
        a, b = (self._plane(write, required(value)) for value in node.inputs)
        count = required(fixed_shape(node.inputs[0]))[2]
        if count == 1:
            return write.op("Mul", a, b)
        sizes = write.int64(*[1] * count)
        columns, lines = (
            write.ops("Split", count, a, sizes, axis=1),
            write.ops("Split", count, b, sizes, axis=0),
        )
        total, *terms = (
            write.op("Mul", column, line) for column, line in zip(columns, lines, strict=True)
        )
        for term in terms:
            total = write.op("Add", total, term)
        return total

    def _operand(
        self, write: InsertionPoint, value: ir.Value | None, shape: tuple[int, ...]
    ) -> ir.Value | None:
        """Return an operand of a node on planes: a plane, or numbers for all rows [..., 1]."""
        if value is None:
            return None
        operand = required(fixed_shape(value))
        if len(operand) == len(shape) and operand[0] == self.rows:
            return self._plane(write, value)
        if prod(operand) == 1:
            return value
        # The first axis has one element, so that it can be the last one instead.
        sizes = [*[1] * (len(shape) - len(operand)), *operand][1:]
        sizes.append(1)
        known = constant_of(value)
        if known is not None:
            return write.constant(known.reshape(sizes), "numbers")
        return write.op("Reshape", value, write.int64(*sizes))

    def _plane(self, write: InsertionPoint, value: ir.Value) -> ir.Value:
        """Return a tensor of rows as planes; one from outside of the group is transposed once."""
        if value not in self._planes:
            shape = required(fixed_shape(value))
            order = (*shape[1:], self.rows)
            self._planes[value] = _moved(write, value, order, is_first=True)
        return self._planes[value]

    def _write_rows(self, write: InsertionPoint, plane: ir.Value, value: ir.Value) -> ir.Value:
        """Return planes as a tensor of rows, with the shape of a graph value."""
        shape = required(fixed_shape(value))
        rows = _moved(write, plane, shape, is_first=False)
        rows.type, rows.shape = value.type, value.shape
        return rows


def _moved(
    write: InsertionPoint, value: ir.Value, shape: Sequence[int], *, is_first: bool
) -> ir.Value:
    """Return a value whose first or last axis counts the rows with that axis last or first."""
    if len(shape) == 1:
        return value
    rows = shape[-1] if is_first else shape[0]
    width = prod(shape) // rows
    if width > 1:
        flat = (rows, width) if is_first else (width, rows)
        if len(shape) > 2:  # more axes, even of one element, take ten times as long
            value = write.op("Reshape", value, write.int64(*flat), shape=flat)
        value = write.op("Transpose", value, shape=flat[::-1], perm=[1, 0])
    if width == 1 or len(shape) > 2:
        value = write.op("Reshape", value, write.int64(*shape), shape=shape)
    return value


def _broadcast_run(node: ir.Node) -> int:
    """Return how many numbers of a row one step of a broadcast covers; all without a broadcast.

    A step covers the last axes along which the same operands are repeated.
    """
    shape = required(fixed_shape(node.outputs[0]))
    operands = [required(fixed_shape(value)) for value in node.inputs if value is not None]
    run, step_pattern = 1, None
    for axis in range(1, len(shape)):
        if shape[-axis] == 1:
            continue
        pattern = [len(operand) < axis or operand[-axis] == 1 for operand in operands]
        if pattern != (step_pattern or pattern):
            return run
        run, step_pattern = run * shape[-axis], pattern
    return run
