"""Norms and normalisations, written out with sums and roots."""

__all__ = ["WriteOutNorms"]

import math
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, Substitute
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import fixed_shape, int_attribute, rank_of

# From these operator sets on, axes of a reduction are an argument; before, an attribute.
_AXES_ARE_INPUT = 18
# From this operator set on, GroupNormalization scales channels; before, groups.
_SCALES_CHANNELS = 21
_FLOATS = (ir.DataType.FLOAT, ir.DataType.FLOAT16, ir.DataType.DOUBLE)


class WriteOutNorms(Substitute):
    """Write norms and normalisations with means, products and roots.

    Most releases lack a kernel for one or the other: GroupNormalization in onnxruntime-web 1.30,
    LpNormalization in 1.22, InstanceNormalization from operator set 22 on, RMSNormalization
    everywhere. One such node keeps the whole model from being captured::

        LayerNormalization(x, s, b)   →   d · 1/√(mean(d · d) + ε) · s + b, where d = x − mean(x)

    float16 is computed in float32, as ONNX asks for (``stash_type``).
    """

    name: ClassVar[str] = "write-out-norms"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=1e-5)
    kinds: ClassVar[frozenset[str]] = frozenset(
        {
            "GroupNormalization",
            "InstanceNormalization",
            "LayerNormalization",
            "LpNormalization",
            "MeanVarianceNormalization",
            "RMSNormalization",
        }
    )

    def suits(self, node: ir.Node) -> bool:
        """Say whether dtype and rank are known."""
        value = node.inputs[0]
        return value is not None and value.dtype in _FLOATS and rank_of(value) is not None

    def replace(self, node: ir.Node) -> None:
        """Write the norm out."""
        write = InsertionPoint(node)
        x = node.inputs[0]
        assert x is not None
        _WRITERS[node.op_type](_Norm(write, node, x, self.opset))


class _Norm:
    """What writing one norm out takes."""

    def __init__(
        self, write: InsertionPoint, node: ir.Node, x: ir.Value, opset: int
    ) -> None:
        self.write, self.node, self.opset = write, node, opset
        self.kind = x.dtype
        self.rank = rank_of(x) or 0
        self.half = x.dtype == ir.DataType.FLOAT16
        self.x = self.wide(x)

    def wide(self, value: ir.Value) -> ir.Value:
        """Return ``value`` in the dtype that is computed in."""
        if not self.half:
            return value
        kind = ir.DataType.FLOAT
        return self.write.op("Cast", value, dtype=kind, shape=value.shape, to=int(kind))

    def op(self, kind: str, *inputs: ir.Value) -> ir.Value:
        return self.write.op(kind, *inputs)

    def number(self, value: float) -> ir.Value:
        kind = np.float32 if self.half else self.kind.numpy() if self.kind else np.float32
        return self.write.constant(np.asarray(value, kind), "number")

    def argument(self, index: int) -> ir.Value | None:
        value = self.node.inputs[index] if index < len(self.node.inputs) else None
        return None if value is None else self.wide(value)

    def attribute(self, name: str, default: float) -> float:
        given = self.node.attributes.get(name)
        return float(np.float32(default)) if given is None else given.as_float()

    def reduced(self, kind: str, value: ir.Value, axes: list[int]) -> ir.Value:
        """Reduce along ``axes``, which stay with size one."""
        if self.opset >= _AXES_ARE_INPUT or (kind == "ReduceSum" and self.opset >= 13):
            return self.write.op(kind, value, self.write.whole(*axes), keepdims=1)
        return self.write.op(kind, value, axes=axes, keepdims=1)

    def inverse_deviation(
        self, centred: ir.Value, axes: list[int], epsilon: float
    ) -> ir.Value:
        variance = self.reduced("ReduceMean", self.op("Mul", centred, centred), axes)
        guarded = self.op("Add", variance, self.number(epsilon))
        return self.op("Reciprocal", self.op("Sqrt", guarded))

    def scaled(
        self, value: ir.Value, scale: ir.Value | None, bias: ir.Value | None
    ) -> ir.Value:
        value = value if scale is None else self.op("Mul", value, scale)
        return value if bias is None else self.op("Add", value, bias)

    def finish(self, *results: ir.Value) -> None:
        """Cast back, and put the results in the node's place."""
        first, *others = results
        if self.half:
            assert self.kind is not None
            first = self.write.op("Cast", first, dtype=self.kind, to=int(self.kind))
        self.write.replace(first, *others[: len(self.node.outputs) - 1])

    def per_channel(self, value: ir.Value | None) -> ir.Value | None:
        """Give ``value`` [C] an axis of size one for each axis behind the channels."""
        if value is None or self.rank <= 2:
            return value
        axes = list(range(1, self.rank - 1))
        if self.opset >= 13:
            return self.write.op("Unsqueeze", value, self.write.whole(*axes))
        return self.write.op("Unsqueeze", value, axes=axes)


def _layer(norm: _Norm) -> None:
    first = int_attribute(norm.node, "axis", -1) % norm.rank
    axes = list(range(first, norm.rank))
    mean = norm.reduced("ReduceMean", norm.x, axes)
    centred = norm.op("Sub", norm.x, mean)
    inverse = norm.inverse_deviation(centred, axes, norm.attribute("epsilon", 1e-5))
    even = norm.op("Mul", centred, inverse)
    norm.finish(norm.scaled(even, norm.argument(1), norm.argument(2)), mean, inverse)


def _root_mean_square(norm: _Norm) -> None:
    first = int_attribute(norm.node, "axis", -1) % norm.rank
    axes = list(range(first, norm.rank))
    inverse = norm.inverse_deviation(norm.x, axes, norm.attribute("epsilon", 1e-5))
    norm.finish(norm.scaled(norm.op("Mul", norm.x, inverse), norm.argument(1), None))


def _instance(norm: _Norm) -> None:
    axes = list(range(2, norm.rank))
    centred = norm.op("Sub", norm.x, norm.reduced("ReduceMean", norm.x, axes))
    inverse = norm.inverse_deviation(centred, axes, norm.attribute("epsilon", 1e-5))
    scale, bias = (norm.per_channel(norm.argument(index)) for index in (1, 2))
    norm.finish(norm.scaled(norm.op("Mul", centred, inverse), scale, bias))


def _group(norm: _Norm) -> None:
    groups = norm.node.attributes["num_groups"].as_int()
    sizes = fixed_shape(norm.x)
    size = norm.op("Shape", norm.x) if sizes is None else norm.write.whole(*sizes)
    if sizes is None:
        size.type = ir.TensorType(ir.DataType.INT64)
    grouped = norm.op("Reshape", norm.x, norm.write.whole(0, groups, -1))
    centred = norm.op("Sub", grouped, norm.reduced("ReduceMean", grouped, [2]))
    inverse = norm.inverse_deviation(centred, [2], norm.attribute("epsilon", 1e-5))
    even = norm.op("Mul", centred, inverse)
    scale, bias = norm.argument(1), norm.argument(2)
    if norm.opset < _SCALES_CHANNELS:  # one number a group
        scale, bias = (
            None if one is None else norm.write.op("Unsqueeze", one, norm.write.whole(1))
            for one in (scale, bias)
        )
        norm.finish(norm.op("Reshape", norm.scaled(even, scale, bias), size))
        return
    flat = norm.op("Reshape", even, size)
    norm.finish(norm.scaled(flat, norm.per_channel(scale), norm.per_channel(bias)))


def _length(norm: _Norm) -> None:
    """Write LpNormalization; where the length is zero, ONNX Runtime returns zero."""
    axis = int_attribute(norm.node, "axis", -1)
    if int_attribute(norm.node, "p", 2) == 1:
        length = norm.reduced("ReduceSum", norm.op("Abs", norm.x), [axis])
    else:
        squares = norm.op("Mul", norm.x, norm.x)
        length = norm.op("Sqrt", norm.reduced("ReduceSum", squares, [axis]))
    none = norm.write.op("Equal", length, norm.number(0), dtype=ir.DataType.BOOL)
    safe = norm.write.op("Where", none, norm.number(math.inf), length, dtype=length.dtype)
    norm.finish(norm.op("Div", norm.x, safe))


def _mean_variance(norm: _Norm) -> None:
    given = norm.node.attributes.get("axes")
    axes = list(given.as_ints()) if given is not None else [0, 2, 3]
    centred = norm.op("Sub", norm.x, norm.reduced("ReduceMean", norm.x, axes))
    variance = norm.reduced("ReduceMean", norm.op("Mul", centred, centred), axes)
    guarded = norm.op("Add", norm.op("Sqrt", variance), norm.number(1e-9))
    norm.finish(norm.op("Div", centred, guarded))


_WRITERS: dict[str, Callable[[_Norm], None]] = {
    "GroupNormalization": _group,
    "InstanceNormalization": _instance,
    "LayerNormalization": _layer,
    "LpNormalization": _length,
    "MeanVarianceNormalization": _mean_variance,
    "RMSNormalization": _root_mean_square,
}
