"""Splits weights that are larger than the target's GPU can bind."""

__all__ = ["SplitLargeWeights"]

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, RewriteTarget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint, weight
from gsgen.sdk.passes.framework.value_facts import (
    constant_of,
    fixed_shape,
    int_attribute,
    rank_of,
    required,
)

_MAX_BINDING_BYTES = 128 << 20  # every WebGPU device binds this many bytes
_BOOL = ir.DataType.BOOL


class SplitLargeWeights(SkippableRewrite):
    """Split every weight that is larger than the target's GPU can bind.

    WebGPU binds 128 MiB unless a device offers more; onnxruntime-web 1.22 returns zeros for a
    larger tensor, without any error. A table is split along its indexed axis, a factor of a
    product along its columns (or its rows, if it is the left one)::

        1  Gather(W, i)   →   Where(i ≥ n, Gather(W₂, i − n), Gather(W₁, i))
        2  MatMul(x, W)   →   Concat(MatMul(x, W₁), MatMul(x, W₂)), and likewise for W on the left
        3  Gemm(x, W, b)  →   Concat(Gemm(x, W₁, b₁), Gemm(x, W₂, b₂))

    Lookups keep every bit; products of fewer columns may round differently. A weight stays if
    another operator reads it whole, because the result is as large. A large output stays, too: the
    contract has one tensor of rows, and the refusal reports how many of them fit.
    """

    name = "split-large-weights"
    exactness = ErrorBudget(relative=2e-6)
    wanted_by = "targets that limit a binding"

    def __init__(self, limit: int = _MAX_BINDING_BYTES) -> None:
        super().__init__()
        self.limit = limit

    @classmethod
    def for_target(cls, target: RewriteTarget) -> "SplitLargeWeights":
        """Return the rewrite that splits weights larger than the target GPU can bind."""
        return cls(target.limits.get("binding_bytes", _MAX_BINDING_BYTES))

    def rewrite(self, model: ir.Model) -> None:
        """Split weights that exceed the GPU's binding limit; report outputs that exceed it."""
        for graph in (model.graph, *model.graph.subgraphs()):
            for value in list(graph.initializers.values()):
                if value.const_value is not None and value.const_value.nbytes > self.limit:
                    self._split(graph, value)
        for value in model.graph.outputs:
            self._refuse_large_output(value)

    def _split(self, graph: ir.Graph, value: ir.Value) -> None:
        uses = list(value.uses())
        plans = [self._plan_split(value, node, input_index) for node, input_index in uses]
        if value.is_graph_input() or value.is_graph_output():
            self.refuse(value, "it is also an input or an output")
            return
        if len({node for node, _ in uses}) < len(uses):
            self.refuse(value, "one operator reads it twice")
            return
        splits = [plan for plan in plans if not isinstance(plan, str)]
        obstacle_texts = [plan for plan in plans if isinstance(plan, str)]
        if obstacle_texts or not splits:
            self.refuse(value, "; ".join(dict.fromkeys(obstacle_texts)) or "nothing reads it")
            return
        self.note(value)
        for plan in splits:
            plan()
        graph.initializers.pop(value.name or "")

    def _plan_split(
        self, value: ir.Value, node: ir.Node, input_index: int
    ) -> "str | Callable[[], None]":
        """Return a function that divides a weight of a node, or why the weight is indivisible."""
        split_axis_and_writer = _splitting_axis(value, node, input_index)
        if isinstance(split_axis_and_writer, str):
            return split_axis_and_writer
        axis, write = split_axis_and_writer
        shape, tensor = required(fixed_shape(value)), required(value.const_value)
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

    def _refuse_large_output(self, value: ir.Value) -> None:
        shape, kind = fixed_shape(value), value.dtype
        if not shape or kind is None:
            return
        row = int(np.prod(shape[1:])) * kind.itemsize
        if row * shape[0] > self.limit:
            max_rows = int(self.limit // row)
            self.refuse(
                value,
                f"{int(row * shape[0])} bytes, and an output cannot be split: {max_rows} rows fit; "
                "float16 or a lower SH degree makes room for more",
            )


WritePartsFunction = Callable[[ir.Node, list[ir.Value], list[int]], None]


def _splitting_axis(
    value: ir.Value, node: ir.Node, input_index: int
) -> tuple[int, WritePartsFunction] | str:
    """Return the axis along which to split a weight, and a function that splits; else why not."""
    rank = rank_of(value) or 0
    # Case 1
    if is_op(node, "Gather") and input_index == 0 and rank_of(node.inputs[1]) is not None:
        return int_attribute(node, "axis", 0) % rank, _split_gather
    # Case 2
    if is_op(node, "MatMul") and rank == 2 and (rank_of(node.inputs[1 - input_index]) or 0) > 1:
        return (1, _split_matmul_columns) if input_index == 1 else (0, _split_matmul_rows)
    # Case 3
    if is_op(node, "Gemm") and input_index == 1:
        bias_operand = node.inputs[2] if len(node.inputs) > 2 else None
        if bias_operand is None or constant_of(bias_operand, largest=1 << 62) is not None:
            return (0 if int_attribute(node, "transB", 0) else 1), _split_gemm
    return f"{node.op_type} {node.name or ''} reads it whole".replace("  ", " ")


def _split_gather(node: ir.Node, parts: list[ir.Value], bounds: list[int]) -> None:
    before, index = InsertionPoint(node), required(node.inputs[1])
    assert index.dtype is not None
    kind = index.dtype.numpy()
    axis = int_attribute(node, "axis", 0) % (rank_of(parts[0]) or 1)

    def number(value: int) -> ir.Value:
        return before.constant(np.asarray(value, kind), "number")

    zero = number(0)
    is_negative = before.op("Less", index, zero, dtype=_BOOL)
    wrapped_index = before.op("Add", index, number(bounds[-1]))
    index = before.op("Where", is_negative, wrapped_index, index, dtype=index.dtype)
    trailing_axes = (rank_of(parts[0]) or 1) - 1 - axis
    rank = rank_of(node.inputs[1]) or 0
    result: ir.Value | None = None
    for part, (start, end) in zip(parts, pairwise(bounds), strict=True):
        is_in_later_part = before.op("GreaterOrEqual", index, number(start), dtype=_BOOL)
        is_before_end = before.op("Less", index, number(end), dtype=_BOOL)
        local_index = before.op("Sub", index, number(start))
        local_index = before.op("Where", is_in_later_part, local_index, zero, dtype=index.dtype)
        local_index = before.op("Where", is_before_end, local_index, zero, dtype=index.dtype)
        gathered_value = before.op("Gather", part, local_index, axis=axis)
        if result is None:
            result = gathered_value
            continue
        if trailing_axes:
            axes = before.int64(*range(rank, rank + trailing_axes))
            is_in_later_part = before.op("Unsqueeze", is_in_later_part, axes)
        result = before.op("Where", is_in_later_part, gathered_value, result, dtype=part.dtype)
    assert result is not None
    before.replace(result)


def _split_matmul_columns(node: ir.Node, parts: list[ir.Value], bounds: list[int]) -> None:
    before = InsertionPoint(node)
    products = [before.op("MatMul", node.inputs[0], part) for part in parts]
    rank = rank_of(node.inputs[0]) or 2
    before.replace(before.op("Concat", *products, axis=rank - 1))


def _split_matmul_rows(node: ir.Node, parts: list[ir.Value], bounds: list[int]) -> None:
    before = InsertionPoint(node)
    products = [before.op("MatMul", part, node.inputs[1]) for part in parts]
    rank = rank_of(node.inputs[1]) or 2
    before.replace(before.op("Concat", *products, axis=rank - 2))


def _split_gemm(node: ir.Node, parts: list[ir.Value], bounds: list[int]) -> None:
    before = InsertionPoint(node)
    bias = node.inputs[2] if len(node.inputs) > 2 else None
    products = []
    for part, (start, end) in zip(parts, pairwise(bounds), strict=True):
        inputs = [node.inputs[0], part]
        if bias is not None:
            inputs.append(_bias_columns(before, bias, start, end, bounds[-1]))
        copy = ir.Node(
            node.domain,
            "Gemm",
            inputs,
            [*node.attributes.values()],
            name=f"{node.name or node.outputs[0].name}_{start}",
        )
        copy.outputs[0].name, copy.outputs[0].type = (f"{copy.name}_part", node.outputs[0].type)
        before.graph.insert_before(node, copy)
        products.append(copy.outputs[0])
    before.replace(before.op("Concat", *products, axis=1))


def _bias_columns(
    before: InsertionPoint, bias: ir.Value, start: int, end: int, width: int
) -> ir.Value:
    array = required(constant_of(bias, largest=1 << 62))
    if not array.ndim or array.shape[-1] != width or width == 1:
        return bias
    return before.constant(np.ascontiguousarray(array[..., start:end]), "bias")
