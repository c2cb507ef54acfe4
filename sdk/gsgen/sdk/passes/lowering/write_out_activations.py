"""Rewrites activations with Exp and comparisons, for runtimes without their kernels."""

__all__ = ["WriteOutActivations"]

import math
from collections.abc import Callable

import numpy as np
import onnx_ir as ir

from gsgen.contract.spec.onnx_facts import FLOAT_TYPES
from gsgen.sdk.passes.framework.base import ErrorBudget, SubstituteNodes
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import int_attribute, required


class WriteOutActivations(SubstituteNodes):
    """Replace activations by their formulas if a runtime release has no kernel for them.

    No release has kernels for Softsign, Selu and Celu; onnxruntime-web 1.22 has none for Softplus,
    Mish and PRelu; from operator set 22 on, Elu, HardSigmoid, HardSwish and ThresholdedRelu have
    none::

        Softplus(x)   →   Relu(x) + Log(1 + Exp(−|x|))

    Exponents are never positive, so intermediate values do not overflow.
    """

    name = "write-out-activations"
    exactness = ErrorBudget(relative=1e-5, absolute=1e-7)
    kinds = frozenset({
        "Celu", "Elu", "Gelu", "HardSigmoid", "HardSwish", "LogSoftmax", "Mish",
        "PRelu", "Selu", "Shrink", "Softplus", "Softsign", "Swish", "ThresholdedRelu",
    })  # fmt: skip

    def can_replace(self, node: ir.Node) -> bool:
        """Return whether an activation's dtype is a float; LogSoftmax needs operator set 13."""
        value = node.inputs[0]
        if value is None or value.dtype not in FLOAT_TYPES:
            return False
        return node.op_type != "LogSoftmax" or self.opset >= 13  # before, it flattens

    def replace(self, node: ir.Node) -> None:
        """Replace an activation by exponentials and comparisons."""
        write = InsertionPoint(node)
        write.replace(_FORMULA_BY_OPERATOR[node.op_type](_Formula(write, node, self.opset)))


class _Formula:
    """Inserts the operators of an activation's formula into the graph."""

    def __init__(self, write: InsertionPoint, node: ir.Node, opset: int) -> None:
        self.write, self.node, self.opset = write, node, opset
        x = required(node.inputs[0])
        assert x.dtype is not None
        self.x, self.kind = x, x.dtype.numpy()

    def number(self, value: float) -> ir.Value:
        return self.write.constant(np.asarray(value, self.kind), "number")

    def attribute(self, name: str, default: float) -> float:
        attribute_value = self.node.attributes.get(name)
        return default if attribute_value is None else attribute_value.as_float()

    def op(self, kind: str, *inputs: ir.Value | float) -> ir.Value:
        values = [
            self.number(operand) if isinstance(operand, float) else operand for operand in inputs
        ]
        return self.write.op(kind, *values)

    def where(
        self, test: str, bound: float, value_if_true: ir.Value, value_if_false: ir.Value
    ) -> ir.Value:
        """Insert a Where that returns ``value_if_true`` if x is beyond a bound, else ``value_if_false``."""
        limit = self.number(bound)
        is_beyond_bound = self.write.op(test, self.x, limit, dtype=ir.DataType.BOOL)
        return self.write.op(
            "Where", is_beyond_bound, value_if_true, value_if_false, dtype=self.x.dtype
        )

    def negative_part(self) -> ir.Value:
        """Insert min(x, 0) of an activation's argument x into the graph; return the result."""
        return self.op("Neg", self.op("Relu", self.op("Neg", self.x)))

    def negative_exponential(self, scale: float = 1.0) -> ir.Value:
        """Insert e^(x / scale) − 1 where x is negative, else zero, into the graph."""
        scaled_negative = (
            self.negative_part() if scale == 1 else self.op("Div", self.negative_part(), scale)
        )
        return self.op("Sub", self.op("Exp", scaled_negative), 1.0)


def _elu(f: _Formula) -> ir.Value:
    negative_branch = f.op("Mul", f.negative_exponential(), f.attribute("alpha", 1.0))
    return f.op("Add", f.op("Relu", f.x), negative_branch)


def _celu(f: _Formula) -> ir.Value:
    alpha = f.attribute("alpha", 1.0)
    return f.op("Add", f.op("Relu", f.x), f.op("Mul", f.negative_exponential(alpha), alpha))


def _selu(f: _Formula) -> ir.Value:
    alpha = f.attribute("alpha", 1.67326319217681884765625)
    gamma = f.attribute("gamma", 1.05070102214813232421875)
    return f.op(
        "Mul", f.op("Add", f.op("Relu", f.x), f.op("Mul", f.negative_exponential(), alpha)), gamma
    )


def _softplus(f: _Formula) -> ir.Value:
    exponential = f.op("Exp", f.op("Neg", f.op("Abs", f.x)))
    return f.op("Add", f.op("Relu", f.x), f.op("Log", f.op("Add", exponential, 1.0)))


def _gelu(f: _Formula) -> ir.Value:
    approximation_mode = f.node.attributes.get("approximate")
    if approximation_mode is not None and approximation_mode.as_string() == "tanh":
        cube = f.op("Mul", f.op("Mul", f.x, f.x), f.x)
        argument = f.op("Add", f.x, f.op("Mul", cube, 0.044715))
        gate_value = f.op("Tanh", f.op("Mul", argument, math.sqrt(2 / math.pi)))
    else:
        gate_value = f.op("Erf", f.op("Mul", f.x, math.sqrt(0.5)))
    return f.op("Mul", f.op("Mul", f.x, 0.5), f.op("Add", gate_value, 1.0))


def _hard_sigmoid(f: _Formula) -> ir.Value:
    line = f.op("Mul", f.x, f.attribute("alpha", 0.2))
    return f.op("Clip", f.op("Add", line, f.attribute("beta", 0.5)), 0.0, 1.0)


def _hard_swish(f: _Formula) -> ir.Value:
    gate_value = f.op("Clip", f.op("Add", f.op("Mul", f.x, 1 / 6), 0.5), 0.0, 1.0)
    return f.op("Mul", f.x, gate_value)


def _log_softmax(f: _Formula) -> ir.Value:
    axis = int_attribute(f.node, "axis", -1)
    axes = f.write.int64(axis)
    most = (
        f.write.op("ReduceMax", f.x, axes, keepdims=1)
        if f.opset >= 18
        else f.write.op("ReduceMax", f.x, axes=[axis], keepdims=1)
    )
    shifted_input = f.op("Sub", f.x, most)
    total = f.write.op("ReduceSum", f.op("Exp", shifted_input), axes, keepdims=1)
    return f.op("Sub", shifted_input, f.op("Log", total))


def _prelu(f: _Formula) -> ir.Value:
    slope = required(f.node.inputs[1])
    return f.where("Less", 0.0, f.op("Mul", f.x, slope), f.x)


def _write_shrink(f: _Formula) -> ir.Value:
    bound, bias = f.attribute("lambd", 0.5), f.attribute("bias", 0.0)
    shifted_above_bound = f.where("Greater", bound, f.op("Sub", f.x, bias), f.number(0))
    return f.where("Less", -bound, f.op("Add", f.x, bias), shifted_above_bound)


def _swish(f: _Formula) -> ir.Value:
    alpha = f.attribute("alpha", 1.0)
    return f.op("Mul", f.x, f.op("Sigmoid", f.op("Mul", f.x, alpha) if alpha != 1 else f.x))


_FORMULA_BY_OPERATOR: dict[str, Callable[[_Formula], ir.Value]] = {
    "Celu": _celu,
    "Elu": _elu,
    "Gelu": _gelu,
    "HardSigmoid": _hard_sigmoid,
    "HardSwish": _hard_swish,
    "LogSoftmax": _log_softmax,
    "Mish": lambda f: f.op("Mul", f.x, f.op("Tanh", _softplus(f))),
    "PRelu": _prelu,
    "Selu": _selu,
    "Shrink": _write_shrink,
    "Softplus": _softplus,
    "Softsign": lambda f: f.op("Div", f.x, f.op("Add", f.op("Abs", f.x), 1.0)),
    "Swish": _swish,
    "ThresholdedRelu": lambda f: f.where("Greater", f.attribute("alpha", 1.0), f.x, f.number(0)),
}
