"""How small a number inside a graph can become, as far as its operators tell."""

__all__ = ["is_never_zero", "lower_bound", "smallest_normal"]

import math

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.value_facts import constant_of

_MOVES = (
    *("Cast", "Expand", "Flatten", "Gather", "Identity", "Reshape", "Slice", "Squeeze"),
    *("Transpose", "Unsqueeze", "ReduceMax", "ReduceMean", "ReduceMin", "Split"),
)
_NOT_NEGATIVE = (
    *("Abs", "Exp", "ReduceL1", "ReduceL2", "ReduceSumSquare", "Sigmoid", "Softmax"),
    *("Softplus", "HardSigmoid"),
)
_DEEPEST = 40


def smallest_normal(dtype: ir.DataType | None) -> float:
    """Return the smallest positive number that a GPU does not take for zero."""
    return {ir.DataType.FLOAT16: 2.0**-14, ir.DataType.DOUBLE: 2.0**-1022}.get(
        dtype or ir.DataType.FLOAT, 2.0**-126
    )


def is_never_zero(value: ir.Value | None) -> bool:
    """Say whether no element of ``value`` is ever zero, or so small that a GPU makes it zero.

    NaN counts as not zero: it is another fault.
    """
    known = constant_of(value)
    if value is None:
        return False
    if known is not None:
        return bool((np.abs(known) >= smallest_normal(value.dtype)).all())
    return lower_bound(value) >= smallest_normal(value.dtype) or _replaces_zero(value)


def lower_bound(value: ir.Value | None, depth: int = 0) -> float:
    """Return a number that ``value`` never falls below; −∞ where none is known."""
    known = constant_of(value)
    if known is not None:
        return float(known.min()) if known.size and not np.isnan(known).any() else -math.inf
    maker = value.producer() if value is not None else None
    if maker is None or depth > _DEEPEST:
        return -math.inf

    def of(place: int) -> float:
        given = maker.inputs[place] if place < len(maker.inputs) else None
        return -math.inf if given is None else lower_bound(given, depth + 1)

    if is_op(maker, *_MOVES):
        return of(0)
    if is_op(maker, *_NOT_NEGATIVE) or _squares(maker):
        return 0.0
    if is_op(maker, "Relu"):
        return max(0.0, of(0))
    if is_op(maker, "Clip"):
        return max(of(0), of(1))
    if is_op(maker, "Max"):
        return max(of(place) for place in range(len(maker.inputs)))
    if is_op(maker, "Min", "Concat"):
        return min(of(place) for place in range(len(maker.inputs)))
    if is_op(maker, "Where"):
        return min(of(1), of(2))
    if is_op(maker, "Add"):
        return of(0) + of(1)
    if is_op(maker, "Mul"):
        return of(0) * of(1) if of(0) >= 0 and of(1) >= 0 else -math.inf
    if is_op(maker, "Sqrt"):
        return math.sqrt(max(0.0, of(0)))
    if is_op(maker, "ReduceSum"):
        return of(0) if of(0) >= 0 else -math.inf
    return -math.inf


def _squares(node: ir.Node) -> bool:
    """Say whether ``node`` gives squares: x · x, or x to an even power."""
    if is_op(node, "Mul"):
        return node.inputs[0] is node.inputs[1]
    power = constant_of(node.inputs[1]) if is_op(node, "Pow") else None
    return power is not None and bool((power % 2 == 0).all() and (power > 0).all())


def _replaces_zero(value: ir.Value) -> bool:
    """Say whether ``value`` is Where(v = 0, c, v) or Where(v > 0, v, c) with c that is not zero."""
    maker = value.producer()
    test = maker.inputs[0].producer() if is_op(maker, "Where") and maker.inputs[0] else None  # type: ignore[union-attr]
    if maker is None or test is None or not is_op(test, "Equal", "Greater"):
        return False
    zero, chosen, other = constant_of(test.inputs[1]), *maker.inputs[1:3]
    if zero is None:
        return False
    if is_op(test, "Equal"):
        return not zero.any() and other is test.inputs[0] and is_never_zero(chosen)
    above = bool((zero >= 0).all())
    return above and chosen is test.inputs[0] and is_never_zero(other)
