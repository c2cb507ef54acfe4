"""Rewrites normalisations with means, products and roots, for runtimes without their kernels."""

__all__ = ["WriteOutNorms"]

import math
from collections.abc import Callable

import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.onnx_facts import FLOAT_TYPES
from gsgen.sdk.passes.framework.base import ErrorBudget, SubstituteNodes
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import fixed_shape, int_attribute, rank_of, required

# From this operator set on, the axes of a reduction are an input; before, an attribute.
_AXES_INPUT_OPSET = 18
# From this operator set on, GroupNormalization has a scale per channel; before, per group.
_CHANNEL_SCALE_OPSET = 21


class WriteOutNorms(SubstituteNodes):
    """Replace normalisation operators by means, products and roots.

    Most releases lack a kernel for some of them: GroupNormalization in onnxruntime-web 1.30,
    LpNormalization in 1.22, InstanceNormalization from operator set 22 on, RMSNormalization
    everywhere. One such node prevents the capture of the whole model::

        LayerNormalization(x, s, b)   →   d · 1/√(mean(d · d) + ε) · s + b, where d = x − mean(x)

    float16 is computed in float32, as ONNX requires (``stash_type``).
    """

    name = "write-out-norms"
    exactness = ErrorBudget(relative=1e-5)
    kinds = frozenset(
        {
            "GroupNormalization",
            "InstanceNormalization",
            "LayerNormalization",
            "LpNormalization",
            "MeanVarianceNormalization",
            "RMSNormalization",
        }
    )

    def can_replace(self, node: ir.Node) -> bool:
        """Return whether dtype and rank of a normalisation's input are known."""
        value = node.inputs[0]
        return value is not None and value.dtype in FLOAT_TYPES and rank_of(value) is not None

    def replace(self, node: ir.Node) -> None:
        """Replace a normalisation operator by means, products and roots."""
        write = InsertionPoint(node)
        x = required(node.inputs[0])
        _NORM_WRITERS[node.op_type](_NormWriter(write, node, x, self.opset))


class _NormWriter:
    """Inserts the operators of a normalisation's formula into the graph."""

    def __init__(self, write: InsertionPoint, node: ir.Node, x: ir.Value, opset: int) -> None:
        self.write, self.node, self.opset = write, node, opset
        self.kind = x.dtype
        self.rank = rank_of(x) or 0
        self.is_float16 = x.dtype == ir.DataType.FLOAT16
        self.x = self.computed(x)

    def computed(self, value: ir.Value) -> ir.Value:
        """Cast a float16 value to float32, in which the normalisation is computed."""
        if not self.is_float16:
            return value
        kind = ir.DataType.FLOAT
        return self.write.op("Cast", value, dtype=kind, shape=value.shape, to=int(kind))

    def op(self, kind: str, *inputs: ir.Value) -> ir.Value:
        return self.write.op(kind, *inputs)

    def number(self, value: float) -> ir.Value:
        kind = np.float32 if self.is_float16 else self.kind.numpy() if self.kind else np.float32
        return self.write.constant(np.asarray(value, kind), "number")

    def argument(self, index: int) -> ir.Value | None:
        value = self.node.inputs[index] if index < len(self.node.inputs) else None
        return None if value is None else self.computed(value)

    def attribute(self, name: str, default: float) -> float:
        attribute_value = self.node.attributes.get(name)
        return float(np.float32(default)) if attribute_value is None else attribute_value.as_float()

    def reduced(self, kind: str, value: ir.Value, axes: list[int]) -> ir.Value:
        """Insert a reduction of a graph value along axes, which keep size one."""
        if self.opset >= _AXES_INPUT_OPSET or (kind == "ReduceSum" and self.opset >= 13):
            return self.write.op(kind, value, self.write.int64(*axes), keepdims=1)
        return self.write.op(kind, value, axes=axes, keepdims=1)

    def inverse_deviation(self, centred: ir.Value, axes: list[int], epsilon: float) -> ir.Value:
        variance = self.reduced("ReduceMean", self.op("Mul", centred, centred), axes)
        guarded_value = self.op("Add", variance, self.number(epsilon))
        return self.op("Reciprocal", self.op("Sqrt", guarded_value))

    def scaled(self, value: ir.Value, scale: ir.Value | None, bias: ir.Value | None) -> ir.Value:
        value = value if scale is None else self.op("Mul", value, scale)
        return value if bias is None else self.op("Add", value, bias)

    def finish(self, *results: ir.Value) -> None:
        """Cast the result of a normalisation to the replaced node's dtype, and replace the node."""
        first, *statistics = results
        if self.is_float16:
            assert self.kind is not None
            first = self.write.op("Cast", first, dtype=self.kind, to=int(self.kind))
        self.write.replace(first, *statistics[: len(self.node.outputs) - 1])

    def per_channel(self, value: ir.Value | None) -> ir.Value | None:
        """Append axes of size one to per-channel values [C], for axes after the channels."""
        if value is None or self.rank <= 2:
            return value
        axes = list(range(1, self.rank - 1))
        if self.opset >= 13:
            return self.write.op("Unsqueeze", value, self.write.int64(*axes))
        return self.write.op("Unsqueeze", value, axes=axes)


def _layer_norm(norm: _NormWriter) -> None:
    first = int_attribute(norm.node, "axis", -1) % norm.rank
    axes = list(range(first, norm.rank))
    mean = norm.reduced("ReduceMean", norm.x, axes)
    centred = norm.op("Sub", norm.x, mean)
    inverse_deviation = norm.inverse_deviation(centred, axes, norm.attribute("epsilon", 1e-5))
    normalised_value = norm.op("Mul", centred, inverse_deviation)
    norm.finish(
        norm.scaled(normalised_value, norm.argument(1), norm.argument(2)), mean, inverse_deviation
    )


def _root_mean_square(norm: _NormWriter) -> None:
    first = int_attribute(norm.node, "axis", -1) % norm.rank
    axes = list(range(first, norm.rank))
    inverse_deviation = norm.inverse_deviation(norm.x, axes, norm.attribute("epsilon", 1e-5))
    norm.finish(norm.scaled(norm.op("Mul", norm.x, inverse_deviation), norm.argument(1), None))


def _write_instance_norm(norm: _NormWriter) -> None:
    axes = list(range(2, norm.rank))
    centred = norm.op("Sub", norm.x, norm.reduced("ReduceMean", norm.x, axes))
    inverse_deviation = norm.inverse_deviation(centred, axes, norm.attribute("epsilon", 1e-5))
    scale, bias = (norm.per_channel(norm.argument(index)) for index in (1, 2))
    norm.finish(norm.scaled(norm.op("Mul", centred, inverse_deviation), scale, bias))


def _group_norm(norm: _NormWriter) -> None:
    groups = norm.node.attributes["num_groups"].as_int()
    sizes = fixed_shape(norm.x)
    size = norm.op("Shape", norm.x) if sizes is None else norm.write.int64(*sizes)
    if sizes is None:
        size.type = ir.TensorType(ir.DataType.INT64)
    grouped = norm.op("Reshape", norm.x, norm.write.int64(0, groups, -1))
    centred = norm.op("Sub", grouped, norm.reduced("ReduceMean", grouped, [2]))
    inverse_deviation = norm.inverse_deviation(centred, [2], norm.attribute("epsilon", 1e-5))
    normalised_value = norm.op("Mul", centred, inverse_deviation)
    scale, bias = norm.argument(1), norm.argument(2)
    if norm.opset < _CHANNEL_SCALE_OPSET:  # one number per group
        scale, bias = (
            None
            if parameter is None
            else norm.write.op("Unsqueeze", parameter, norm.write.int64(1))
            for parameter in (scale, bias)
        )
        norm.finish(norm.op("Reshape", norm.scaled(normalised_value, scale, bias), size))
        return
    flat = norm.op("Reshape", normalised_value, size)
    norm.finish(norm.scaled(flat, norm.per_channel(scale), norm.per_channel(bias)))


def _lp_norm(norm: _NormWriter) -> None:
    """Replace LpNormalization by its formula; a vector of length zero stays zero."""
    axis = int_attribute(norm.node, "axis", -1)
    if int_attribute(norm.node, "p", 2) == 1:
        length = norm.reduced("ReduceSum", norm.op("Abs", norm.x), [axis])
    else:
        squares = norm.op("Mul", norm.x, norm.x)
        length = norm.op("Sqrt", norm.reduced("ReduceSum", squares, [axis]))
    is_zero = norm.write.op("Equal", length, norm.number(0), dtype=ir.DataType.BOOL)
    safe_length = norm.write.op("Where", is_zero, norm.number(math.inf), length, dtype=length.dtype)
    norm.finish(norm.op("Div", norm.x, safe_length))


def _mean_variance(norm: _NormWriter) -> None:
    attribute = norm.node.attributes.get("axes")
    axes = list(attribute.as_ints()) if attribute is not None else [0, 2, 3]
    centred = norm.op("Sub", norm.x, norm.reduced("ReduceMean", norm.x, axes))
    variance = norm.reduced("ReduceMean", norm.op("Mul", centred, centred), axes)
    guarded_value = norm.op("Add", norm.op("Sqrt", variance), norm.number(1e-9))
    norm.finish(norm.op("Div", centred, guarded_value))


_NORM_WRITERS: dict[str, Callable[[_NormWriter], None]] = {
    "GroupNormalization": _group_norm,
    "InstanceNormalization": _write_instance_norm,
    "LayerNormalization": _layer_norm,
    "LpNormalization": _lp_norm,
    "MeanVarianceNormalization": _mean_variance,
    "RMSNormalization": _root_mean_square,
}
