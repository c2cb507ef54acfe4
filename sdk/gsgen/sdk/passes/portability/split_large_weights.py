"""Weights that a target can bind."""

__all__ = ["SplitLargeWeights"]

from collections.abc import Callable
from itertools import pairwise
from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, RewriteTarget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint, weight
from gsgen.sdk.passes.framework.value_facts import (
    constant_of,
    fixed_shape,
    int_attribute,
    rank_of,
)

_BINDING = 128 << 20  # what every WebGPU device binds
_BOOL = ir.DataType.BOOL


class SplitLargeWeights(CautiousRewrite):
    """Split every weight that is larger than a target can bind.

    WebGPU binds 128 MiB unless a device offers more; onnxruntime-web 1.22 returns zeros for a
    larger tensor, without any error. A table is split along the axis that is looked up, a factor of
    a product along its columns (or its rows, if it is the left one)::

        Gather(W, i)    →   Where(i ≥ n, Gather(W₂, i − n), Gather(W₁, i))
        MatMul(x, W)    →   Concat(MatMul(x, W₁), MatMul(x, W₂))

    Lookups keep every bit; products of fewer columns may round otherwise. A weight that something
    else reads whole stays: what is made of it is as large. So does a large output: the contract
    knows one tensor of rows, and the refusal says how many of them fit.
    """

    name: ClassVar[str] = "split-large-weights"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=2e-6)
    wanted_by: ClassVar[str] = "targets that limit a binding"

    def __init__(self, limit: int = _BINDING) -> None:
        super().__init__()
        self.limit = limit

    @classmethod
    def for_goal(cls, goal: RewriteTarget) -> "SplitLargeWeights":
        """Return the pass with the target's limit."""
        return cls(goal.limits.get("binding_bytes", _BINDING))

    def rewrite(self, model: ir.Model) -> None:
        """Split weights of the main graph and of bodies; name what stays large."""
        for graph in (model.graph, *model.graph.subgraphs()):
            for value in list(graph.initializers.values()):
                if value.const_value is not None and value.const_value.nbytes > self.limit:
                    self._split(graph, value)
        for value in model.graph.outputs:
            self._look_at(value)

    def _split(self, graph: ir.Graph, value: ir.Value) -> None:
        uses = list(value.uses())
        plans = [self._plan(value, node, place) for node, place in uses]
        if value.is_graph_input() or value.is_graph_output():
            self.refuse(value, "it is an input or an output, too")
            return
        if len({node for node, _ in uses}) < len(uses):
            self.refuse(value, "one operator reads it twice")
            return
        whole = [plan for plan in plans if not isinstance(plan, str)]
        obstacles = [plan for plan in plans if isinstance(plan, str)]
        if obstacles or not whole:
            self.refuse(value, "; ".join(dict.fromkeys(obstacles)) or "nothing reads it")
            return
        self.note(value)
        for plan in whole:
            plan()
        graph.initializers.pop(value.name or "")

    def _plan(
        self, value: ir.Value, node: ir.Node, place: int
    ) -> "str | Callable[[], None]":
        """Return what splits ``value`` where ``node`` reads it, or why that cannot be done."""
        found = _along(value, node, place)
        if isinstance(found, str):
            return found
        axis, write = found
        shape, tensor = fixed_shape(value), value.const_value
        assert shape is not None
        assert tensor is not None
        slab = tensor.nbytes // shape[axis]
        if slab > self.limit:
            return f"one of its {shape[axis]} parts along axis {axis} is {slab} bytes"
        bounds = [*range(0, shape[axis], self.limit // slab), shape[axis]]

        def split() -> None:
            assert isinstance(node.graph, ir.Graph)
            array, parts = tensor.numpy(), []
            for start, end in pairwise(bounds):
                part = np.ascontiguousarray(array.take(range(start, end), axis=axis))
                parts.append(weight(node.graph, f"{value.name}_{start}", part))
            write(node, parts, bounds)

        return split

    def _look_at(self, value: ir.Value) -> None:
        shape, kind = fixed_shape(value), value.dtype
        if not shape or kind is None:
            return
        row = int(np.prod(shape[1:])) * kind.itemsize
        if row * shape[0] > self.limit:
            fit = int(self.limit // row)
            self.refuse(
                value,
                f"{int(row * shape[0])} bytes, and an output cannot be split: {fit} rows fit; "
                "float16 or a lower SH degree makes room for more",
            )


Write = Callable[[ir.Node, list[ir.Value], list[int]], None]


def _along(value: ir.Value, node: ir.Node, place: int) -> tuple[int, Write] | str:
    """Return the axis along which ``node`` allows its input to be split, and how to rewrite it."""
    rank = rank_of(value) or 0
    if is_op(node, "Gather") and place == 0 and rank_of(node.inputs[1]) is not None:
        return int_attribute(node, "axis", 0) % rank, _look_up
    if is_op(node, "MatMul") and rank == 2 and (rank_of(node.inputs[1 - place]) or 0) > 1:
        return (1, _by_columns) if place == 1 else (0, _by_rows)
    if is_op(node, "Gemm") and place == 1:
        added = node.inputs[2] if len(node.inputs) > 2 else None
        if added is None or constant_of(added, largest=1 << 62) is not None:
            return (0 if int_attribute(node, "transB", 0) else 1), _gemm
    return f"{node.op_type} {node.name or ''} reads it whole".replace("  ", " ")


def _look_up(node: ir.Node, parts: list[ir.Value], bounds: list[int]) -> None:
    before, index = InsertionPoint(node), node.inputs[1]
    assert index is not None
    assert index.dtype is not None
    kind = index.dtype.numpy()
    axis = int_attribute(node, "axis", 0) % (rank_of(parts[0]) or 1)

    def number(value: int) -> ir.Value:
        return before.constant(np.asarray(value, kind), "number")

    zero = number(0)
    negative = before.op("Less", index, zero, dtype=_BOOL)
    raised = before.op("Add", index, number(bounds[-1]))
    index = before.op("Where", negative, raised, index, dtype=index.dtype)
    behind = (rank_of(parts[0]) or 1) - 1 - axis
    rank = rank_of(node.inputs[1]) or 0
    made: ir.Value | None = None
    for part, (start, end) in zip(parts, pairwise(bounds), strict=True):
        from_here = before.op("GreaterOrEqual", index, number(start), dtype=_BOOL)
        until = before.op("Less", index, number(end), dtype=_BOOL)
        local = before.op("Sub", index, number(start))
        local = before.op("Where", from_here, local, zero, dtype=index.dtype)
        local = before.op("Where", until, local, zero, dtype=index.dtype)
        taken = before.op("Gather", part, local, axis=axis)
        if made is None:
            made = taken
            continue
        if behind:
            axes = before.whole(*range(rank, rank + behind))
            from_here = before.op("Unsqueeze", from_here, axes)
        made = before.op("Where", from_here, taken, made, dtype=part.dtype)
    assert made is not None
    before.replace(made)


def _by_columns(node: ir.Node, parts: list[ir.Value], bounds: list[int]) -> None:
    before = InsertionPoint(node)
    made = [before.op("MatMul", node.inputs[0], part) for part in parts]
    rank = rank_of(node.inputs[0]) or 2
    before.replace(before.op("Concat", *made, axis=rank - 1))


def _by_rows(node: ir.Node, parts: list[ir.Value], bounds: list[int]) -> None:
    before = InsertionPoint(node)
    made = [before.op("MatMul", part, node.inputs[1]) for part in parts]
    rank = rank_of(node.inputs[1]) or 2
    before.replace(before.op("Concat", *made, axis=rank - 2))


def _gemm(node: ir.Node, parts: list[ir.Value], bounds: list[int]) -> None:
    before = InsertionPoint(node)
    added = node.inputs[2] if len(node.inputs) > 2 else None
    made = []
    for part, (start, end) in zip(parts, pairwise(bounds), strict=True):
        inputs = [node.inputs[0], part]
        if added is not None:
            inputs.append(_columns(before, added, start, end, bounds[-1]))
        copy = ir.Node(
            node.domain,
            "Gemm",
            inputs,
            [*node.attributes.values()],
            name=f"{node.name or node.outputs[0].name}_{start}",
        )
        copy.outputs[0].name, copy.outputs[0].type = (
            f"{copy.name}_part",
            node.outputs[0].type,
        )
        before.graph.insert_before(node, copy)
        made.append(copy.outputs[0])
    before.replace(before.op("Concat", *made, axis=1))


def _columns(
    before: InsertionPoint, added: ir.Value, start: int, end: int, width: int
) -> ir.Value:
    array = constant_of(added, largest=1 << 62)
    assert array is not None
    if not array.ndim or array.shape[-1] != width or width == 1:
        return added
    return before.constant(np.ascontiguousarray(array[..., start:end]), "bias")
