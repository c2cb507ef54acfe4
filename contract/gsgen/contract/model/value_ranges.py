"""Interval arithmetic on an ONNX graph: lower and upper bounds of the values of each tensor."""

__all__ = ["Interval", "intervals"]

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from onnx import NodeProto, TensorProto

from gsgen.contract.model.graph import Graph, Tensor
from gsgen.contract.model.model_file import small_array
from gsgen.contract.spec.fields.roles import ROLES
from gsgen.contract.spec.manifest import Manifest

Interval = tuple[float, float]

_INT32 = (-(2.0**31), 2.0**31 - 1)
_BOUNDED_OPERATORS: dict[str, Interval] = {
    "Sigmoid": (0, 1),
    "HardSigmoid": (0, 1),
    "Softmax": (0, 1),
    "Tanh": (-1, 1),
    "Sin": (-1, 1),
    "Cos": (-1, 1),
    "Erf": (-1, 1),
    # Indices into a tensor, which has fewer elements.
    "NonZero": (0, _INT32[1]),
    "Shape": (0, _INT32[1]),
    "Size": (0, _INT32[1]),
    "Sign": (-1, 1),
    # Booleans count as zero and one where they are cast.
    **dict.fromkeys(("Equal", "Greater", "GreaterOrEqual", "Less", "LessOrEqual"), (0, 1)),
    **dict.fromkeys(("And", "IsInf", "IsNaN", "Not", "Or", "Xor"), (0, 1)),
}
# Operators whose outputs contain only numbers of their inputs.
_MOVING_OPERATORS = frozenset(
    {
        *("Identity", "Reshape", "Squeeze", "Unsqueeze", "Flatten", "Transpose", "Expand"),
        *("Slice", "Gather", "GatherElements", "GatherND", "Split", "Tile", "DepthToSpace", "TopK"),
        *("ReduceMax", "ReduceMin", "ReduceMean", "ReduceSum"),  # sums are counted afterwards
    }
)
_JOINING_OPERATORS = frozenset({"Concat", "Where"})
# Operators that return indices along one axis → which output holds them, and the default axis.
_INDEX_OUTPUTS = {"ArgMax": (0, 0), "ArgMin": (0, 0), "TopK": (1, -1)}


def _product_interval(a: Interval, b: Interval) -> Interval:
    corners = [x * y for x in a for y in b]
    return min(corners), max(corners)


def _quotient_interval(a: Interval, b: Interval) -> Interval:
    if b[0] <= 0 <= b[1]:
        return -math.inf, math.inf
    return _product_interval(a, (1 / b[1], 1 / b[0]))


def _remainder_interval(_: Interval, b: Interval) -> Interval:
    """Return the range of the remainders of an integer division, whichever sign they take."""
    max_magnitude = max(abs(b[0]), abs(b[1]))
    return -max_magnitude, max_magnitude


_BINARY_INTERVALS: dict[str, Callable[[Interval, Interval], Interval]] = {
    "Add": lambda a, b: (a[0] + b[0], a[1] + b[1]),
    "Sub": lambda a, b: (a[0] - b[1], a[1] - b[0]),
    "Mul": _product_interval,
    "Div": _quotient_interval,
    "Min": lambda a, b: (min(a[0], b[0]), min(a[1], b[1])),
    "Max": lambda a, b: (max(a[0], b[0]), max(a[1], b[1])),
    "Mod": _remainder_interval,
}
_UNARY_INTERVALS: dict[str, Callable[[Interval], Interval]] = {
    "Neg": lambda a: (-a[1], -a[0]),
    "Abs": lambda a: (max(0.0, a[0], -a[1]), max(abs(a[0]), abs(a[1]))),
    "Floor": lambda a: (_round_if_finite(a[0], math.floor), _round_if_finite(a[1], math.floor)),
    "Ceil": lambda a: (_round_if_finite(a[0], math.ceil), _round_if_finite(a[1], math.ceil)),
    "Round": lambda a: (_round_if_finite(a[0], math.floor), _round_if_finite(a[1], math.ceil)),
    "Relu": lambda a: (max(0.0, a[0]), max(0.0, a[1])),
    "Cast": lambda a: a,
}


def _round_if_finite(value: float, rounded: Callable[[float], int]) -> float:
    return float(rounded(value)) if math.isfinite(value) else value


def intervals(
    graph: Graph, weights: Iterable[TensorProto], manifest: Manifest | None
) -> dict[str, Interval]:
    """Return the range of values of each graph tensor by name, where bounds are known.

    Args:
        graph: The main graph.
        weights: Its weights; those whose payload was not read count as unknown.
        manifest: Declares the range of each input.
    """
    known = {w.name: span for w in weights if (span := _interval_of_weight(w)) is not None}
    for entry in manifest.inputs if manifest else ():
        if entry.range is not None:
            known[entry.name] = entry.range
        elif ROLES[entry.role].index:
            known[entry.name] = _INT32
    for node in graph.nodes:
        span = _node_interval(node, [known.get(name) for name in node.input])
        output = graph.tensors.get(node.output[0]) if node.output else None
        if span is not None and node.op_type == "ReduceSum":
            span = _sum_interval(span, graph.tensors.get(node.input[0]), output)
        if output is not None and output.dtype == "bool":
            span = (0.0, 1.0)
        if span is None and output is not None and output.dtype == "int32":
            span = _INT32  # no other number fits
        if span is not None:
            known.update({name: span for name in node.output if name})
        if node.op_type in _INDEX_OUTPUTS:
            known.update(_index_intervals(node, graph))
    return known


def _index_intervals(node: NodeProto, graph: Graph) -> dict[str, Interval]:
    """Return the range of the indices that ArgMax, ArgMin or TopK finds along an axis."""
    output, axis = _INDEX_OUTPUTS[node.op_type]
    if output >= len(node.output) or not node.output[output]:
        return {}
    axis = next((entry.i for entry in node.attribute if entry.name == "axis"), axis)
    operand = graph.tensors.get(node.input[0])
    dims = operand.dims if operand is not None else None
    size = dims[axis] if dims is not None and -len(dims) <= axis < len(dims) else None
    max_index = size - 1 if isinstance(size, int) and size > 0 else _INT32[1]
    return {node.output[output]: (0, max_index)}


def _sum_interval(span: Interval, operand: Tensor | None, output: Tensor | None) -> Interval | None:
    """Return the range of a sum over an axis; None if the number of addends is unknown."""
    if operand is None or output is None or operand.dims is None or output.dims is None:
        return None
    sizes = [d for d in (*operand.dims, *output.dims) if isinstance(d, int) and d > 0]
    if len(sizes) != len(operand.dims) + len(output.dims):
        return None
    count = math.prod(sizes[: len(operand.dims)]) / math.prod(sizes[len(operand.dims) :])
    return span[0] * count, span[1] * count


def _interval_of_weight(weight: TensorProto) -> Interval | None:
    array = small_array(weight)
    if array is None:
        return None
    low, high = float(np.min(array)), float(np.max(array))
    return (low, high) if low <= high else None  # NaN bounds nothing


def _node_interval(node: NodeProto, spans: Sequence[Interval | None]) -> Interval | None:
    kind = node.op_type
    if kind in _BOUNDED_OPERATORS:
        return _BOUNDED_OPERATORS[kind]
    if kind == "Clip" and len(spans) == 3:
        low, high = spans[1], spans[2]
        return (low[0], high[1]) if low and high else None
    first = spans[0] if spans else None
    if kind in _MOVING_OPERATORS:
        return first
    if kind in _JOINING_OPERATORS:
        parts = spans[1:] if kind == "Where" else spans
        known_intervals = [part for part in parts if part is not None]
        if len(known_intervals) != len(parts) or not known_intervals:
            return None
        return min(part[0] for part in known_intervals), max(part[1] for part in known_intervals)
    if kind in _UNARY_INTERVALS:
        return None if first is None else _UNARY_INTERVALS[kind](first)
    if kind in _BINARY_INTERVALS and len(spans) == 2:
        second = spans[1]
        return None if first is None or second is None else _BINARY_INTERVALS[kind](first, second)
    return None
