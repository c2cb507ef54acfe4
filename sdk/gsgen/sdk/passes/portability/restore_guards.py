"""Guards against division by zero that were lost on the way."""

__all__ = ["RestoreGuards"]

from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import ErrorBudget, every_node, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.lower_bounds import is_never_zero, smallest_normal
from gsgen.sdk.passes.framework.value_facts import constant_of

_FLOATS = (ir.DataType.FLOAT, ir.DataType.FLOAT16, ir.DataType.DOUBLE)
_MOVES = (
    *("Cast", "Expand", "Flatten", "Gather", "Identity", "Reshape", "Slice", "Squeeze"),
    *("Transpose", "Unsqueeze"),
)
# What stands for a length that is zero, and for its square.
_LENGTH, _SQUARE = 1e-12, 1e-24


class RestoreGuards(CautiousRewrite):
    """Keep the length of a zero vector from being divided by.

    The exporter drops ``x + c`` for c up to 1e-8, and a guard of 1e-12 is zero once it is float16:
    a zero vector, which a rest pose or a camera on a point gives, becomes NaN. Where a length, or
    its square, is divided by and may be zero, a small number takes the place of zero alone::

        v / Sqrt(ReduceSum(v · v))   →   v / Where(length = 0, 1e-12, length)

    So 0 / 0 becomes 0, and what was finite keeps every bit. Lengths are known by their form: the
    root of a sum of squares, or ReduceL2; a guard that is too small for its dtype is looked
    through. A divisor that may be zero and is no length is left alone and named: what a division
    by a depth of zero should give is for the model's author to say.
    """

    name: ClassVar[str] = "restore-guards"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(repairs_nonfinite=True)

    def rewrite(self, model: ir.Model) -> None:
        """Guard every divisor that needs it, subgraphs included."""
        for node in list(every_node(model)):
            place = _divisor_of(node)
            if place is None:
                continue
            divisor = node.inputs[place]
            assert divisor is not None
            if divisor.dtype not in _FLOATS or is_never_zero(divisor):
                continue
            if constant_of(divisor) is not None or not (
                _is_length(divisor) or _is_square(divisor)
            ):
                self.refuse(
                    node, f"its divisor {divisor.name} may be zero, and is no length"
                )
                continue
            self.note(node)
            _guard(node, place)


def _divisor_of(node: ir.Node) -> int | None:
    """Return which input of ``node`` must not be zero."""
    if is_op(node, "Div"):
        return 1
    if is_op(node, "Reciprocal"):
        return 0
    power = constant_of(node.inputs[1]) if is_op(node, "Pow") else None
    return 0 if power is not None and (power < 0).any() else None


def _guard(node: ir.Node, place: int) -> None:
    divisor = node.inputs[place]
    assert divisor is not None
    assert divisor.dtype is not None
    wanted = _LENGTH if _is_length(divisor) else _SQUARE
    least, dtype = max(wanted, smallest_normal(divisor.dtype)), divisor.dtype.numpy()
    before = InsertionPoint(node)
    zero, small = (before.constant(np.asarray(value, dtype)) for value in (0, least))
    at_zero = before.op("Equal", divisor, zero, dtype=ir.DataType.BOOL, shape=divisor.shape)
    guarded = before.op(
        "Where", at_zero, small, divisor, dtype=divisor.dtype, shape=divisor.shape
    )
    node.replace_input_with(place, guarded)


def _is_length(value: ir.Value | None) -> bool:
    maker = _maker(value)
    if is_op(maker, "ReduceL2"):
        return True
    if maker is None or not is_op(maker, "Sqrt", "Pow"):
        return False
    power = constant_of(maker.inputs[1]) if is_op(maker, "Pow") else np.array(0.5)
    return power is not None and bool((power == 0.5).all()) and _is_square(maker.inputs[0])


def _is_square(value: ir.Value | None) -> bool:
    """Say whether ``value`` is a sum or mean of squares."""
    maker = _maker(value)
    if maker is None:
        return False
    if is_op(maker, "ReduceSumSquare") or _is_one_square(maker):
        return True
    if is_op(maker, "ReduceSum", "ReduceMean"):
        return _is_square(maker.inputs[0])
    if is_op(maker, "Add"):
        return _is_square(maker.inputs[0]) and _is_square(maker.inputs[1])
    return False


def _is_one_square(node: ir.Node) -> bool:
    if is_op(node, "Mul"):
        return node.inputs[0] is node.inputs[1]
    power = constant_of(node.inputs[1]) if is_op(node, "Pow") else None
    return power is not None and bool((power == 2).all())


def _maker(value: ir.Value | None) -> ir.Node | None:
    """Return what makes ``value``, seen through moves and guards that are as good as zero."""
    while value is not None:
        maker = value.producer()
        if maker is None:
            return None
        place = 0 if is_op(maker, *_MOVES) else _guarded(maker)
        if place is None:
            return maker
        value = maker.inputs[place]
    return None


def _guarded(node: ir.Node) -> int | None:
    """Return which input a guard guards, where its constant is as good as zero."""
    if not is_op(node, "Add", "Clip", "Max") or len(node.inputs) < 2:
        return None
    for place in (0, 1):
        floor = constant_of(node.inputs[1 - place])
        if floor is None or (is_op(node, "Clip") and place):
            continue
        least = smallest_normal(node.outputs[0].dtype)
        return place if ((floor >= 0) & (floor < least)).all() else None
    return None
