"""ONNX forms of torch's functions of single numbers, also at infinities, NaN and whole quotients."""

__all__ = ["NUMBER_TRANSLATIONS"]

import math
from collections.abc import Callable
from typing import Any, Final

import onnx_ir as ir
import torch
from onnx import TensorProto
from onnx_ir.tensor_adapters import from_torch_dtype, to_torch_dtype
from onnxscript import opset18

# Its types are those of single operators, not of what they return.
_OPSET18: Any = opset18

# Types of numbers that ONNX Runtime raises; others are raised as float32 or int64.
_POWER_TYPES: Final = (
    *(ir.DataType.FLOAT, ir.DataType.DOUBLE, ir.DataType.FLOAT16),
    *(ir.DataType.INT32, ir.DataType.INT64),
)


def _promotable(number: Any) -> Any:
    """Return a number, or for a tensor of the graph an empty one of its type and rank."""
    if isinstance(number, int | float):
        return number
    size = [0] * len(number.shape)
    return torch.empty(size, dtype=to_torch_dtype(number.dtype), device="meta")


def _as_type(number: Any, kind: ir.DataType) -> Any:
    """Return a number or a tensor of the graph as a tensor of another type."""
    if isinstance(number, int | float):
        return _OPSET18.Constant(value=ir.tensor(number, kind))
    return number if number.dtype == kind else _OPSET18.Cast(number, to=int(kind))


def _numbers(kind: ir.DataType, *numbers: float) -> tuple[Any, ...]:
    """Return numbers as tensors of a type."""
    return tuple(_as_type(number, kind) for number in numbers)


def _promoted(a: Any, b: Any) -> tuple[Any, Any, ir.DataType]:
    """Return two operands as tensors of the type that torch gives both together, and the type."""
    kind = from_torch_dtype(torch.result_type(_promotable(a), _promotable(b)))
    return _as_type(a, kind), _as_type(b, kind), kind


def _translate_power(base: Any, exponent: Any) -> Any:
    """Translate ``pow``: ONNX gives the result the base's type, torch the type of both together."""
    promoted = torch.result_type(_promotable(base), _promotable(exponent))
    result_type = from_torch_dtype(promoted)
    other_type = ir.DataType.FLOAT if promoted.is_floating_point else ir.DataType.INT64
    power_type = result_type if result_type in _POWER_TYPES else other_type

    base, exponent = _as_type(base, power_type), _as_type(exponent, power_type)
    if not promoted.is_floating_point:
        # Of whole numbers, torch takes 1 / 0 for 0: so does 0 to the power of 1.
        zero = _OPSET18.CastLike(_OPSET18.Constant(value_int=0), base)
        is_infinite = _OPSET18.And(_OPSET18.Equal(base, zero), _OPSET18.Less(exponent, zero))
        exponent = _OPSET18.Where(is_infinite, _OPSET18.Neg(exponent), exponent)
    power = _OPSET18.Pow(base, exponent)
    if power_type == result_type:
        return power
    return _OPSET18.Cast(power, to=int(result_type))


def _translate_copysign(magnitude: Any, sign: Any) -> Any:
    """Translate ``copysign``: the sign of -0.0 counts."""
    promoted = torch.result_type(_promotable(magnitude), _promotable(sign))
    result_type = promoted if promoted.is_floating_point else torch.get_default_dtype()
    code = int(from_torch_dtype(result_type))
    size = _OPSET18.Abs(_OPSET18.Cast(magnitude, to=code))
    if isinstance(sign, int | float):
        return size if math.copysign(1, sign) > 0 else _OPSET18.Neg(size)
    return _OPSET18.Mul(size, _sign_of(_OPSET18.Cast(sign, to=code), ir.DataType(code)))


def _sign_of(values: Any, kind: ir.DataType) -> Any:
    """Return -1 where floats are negative, -0.0 included, else 1.

    It is a factor: where ONNX Runtime chooses between two tensors, -0.0 becomes 0.0.
    """
    negative, positive = _numbers(kind, -1.0, 1.0)
    return _OPSET18.Where(_is_negative(values), negative, positive)


def _translate_atan2(y: Any, x: Any) -> Any:
    """Translate ``atan2``: the angle of |y| and |x|, put into the quadrant of the signs.

    Signs of zeros count: of y = 0 with a negative x the angle is π, and -π for -0.0.
    """
    kind = from_torch_dtype(torch.result_type(_promotable(y), _promotable(x)))
    kind = kind if kind.is_floating_point() else ir.DataType.FLOAT
    y, x = _as_type(y, kind), _as_type(x, kind)
    zero, one, pi = _numbers(kind, 0.0, 1.0, math.pi)
    height, width = _OPSET18.Abs(y), _OPSET18.Abs(x)
    # Equal sizes have the ratio 1, infinite ones too; that of two zeros is 0.
    equal_ratio = _OPSET18.Where(_OPSET18.Equal(height, zero), zero, one)
    is_equal = _OPSET18.Equal(height, width)
    angle = _OPSET18.Atan(_OPSET18.Where(is_equal, equal_ratio, _OPSET18.Div(height, width)))
    angle = _OPSET18.Where(_is_negative(x), _OPSET18.Sub(pi, angle), angle)
    return _OPSET18.Mul(angle, _sign_of(y, kind))


def _translate_scalar(number: float, dtype: int = TensorProto.FLOAT, **_: Any) -> Any:
    """Translate ``prims.scalar_tensor``, to which torch decomposes the numbers of some functions."""
    return _OPSET18.Constant(value=ir.tensor(number, ir.DataType(dtype)))


def _translate_signbit(values: Any) -> Any:
    """Translate ``signbit``; numbers without a sign are 0 or more."""
    if values.dtype.is_floating_point():
        return _is_negative(values)
    integers = _OPSET18.Cast(values, to=TensorProto.INT64)
    return _OPSET18.Less(integers, _OPSET18.Constant(value_int=0))


def _is_negative(values: Any) -> Any:
    """Return which floats are negative, -0.0 included, as its reciprocal shows."""
    zero = _OPSET18.CastLike(_OPSET18.Constant(value_float=0.0), values)
    is_negative_zero = _OPSET18.And(
        _OPSET18.Equal(values, zero), _OPSET18.Less(_OPSET18.Reciprocal(values), zero)
    )
    return _OPSET18.Or(_OPSET18.Less(values, zero), is_negative_zero)


def _translate_hypot(a: Any, b: Any) -> Any:
    """Translate ``prims.hypot``: the larger size times √(1 + ratio²), whose squares do not overflow."""
    size_a, size_b = _OPSET18.Abs(a), _OPSET18.Abs(b)
    large, small = _OPSET18.Max(size_a, size_b), _OPSET18.Min(size_a, size_b)
    zero, one, infinity = (
        _OPSET18.CastLike(_OPSET18.Constant(value_float=x), a) for x in (0.0, 1.0, float("inf"))
    )
    ratio = _OPSET18.Div(small, _OPSET18.Where(_OPSET18.Equal(large, zero), one, large))
    size = _OPSET18.Mul(large, _OPSET18.Sqrt(_OPSET18.Add(one, _OPSET18.Mul(ratio, ratio))))
    # An infinite side is longer than any other, also beside a NaN.
    is_infinite = _OPSET18.Or(_OPSET18.Equal(size_a, infinity), _OPSET18.Equal(size_b, infinity))
    return _OPSET18.Where(is_infinite, infinity, size)


def _translate_number_extreme(operator: str) -> Callable[..., Any]:
    """Return the translation of ``prims.fmax`` or ``fmin``, which take the number beside a NaN."""

    def translate(a: Any, b: Any) -> Any:
        extreme = getattr(_OPSET18, operator)(a, b)
        if not a.dtype.is_floating_point():
            return extreme
        number = _OPSET18.Where(_OPSET18.IsNaN(b), a, extreme)
        return _OPSET18.Where(_OPSET18.IsNaN(a), b, number)

    return translate


def _translate_remainder(a: Any, b: Any) -> Any:
    """Translate ``remainder``, a - b ⌊a / b⌋ with the quotient that is not rounded.

    A quotient in floats is rounded up to whole numbers: ⌊1 / 0.1⌋ is 10, although 10 times the
    float 0.1 is more than 1. Quotients by a power of two are exact.
    """
    known = _known_number(b)
    a, b, kind = _promoted(a, b)
    if not kind.is_floating_point():
        return _OPSET18.Mod(a, b)
    if _is_power_of_two(known):
        return _OPSET18.Sub(a, _OPSET18.Mul(_OPSET18.Floor(_OPSET18.Div(a, b)), b))
    remainder = _OPSET18.Mod(a, b, fmod=1)
    is_before_zero = _is_between(remainder, b, kind, known)
    return _OPSET18.Where(is_before_zero, _OPSET18.Add(remainder, b), remainder)


def _translate_floor_division(a: Any, b: Any) -> Any:
    """Translate ``a // b``, in floats by the remainder: see `_translate_remainder`."""
    known = _known_number(b)
    a, b, kind = _promoted(a, b)
    if not kind.is_floating_point():
        return _integer_quotient(a, b, kind, is_floor=True)
    if _is_power_of_two(known):
        return _OPSET18.Floor(_OPSET18.Div(a, b))
    zero, half, one = _numbers(kind, 0.0, 0.5, 1.0)
    remainder = _OPSET18.Mod(a, b, fmod=1)
    quotient = _OPSET18.Div(_OPSET18.Sub(a, remainder), b)
    quotient = _OPSET18.Where(
        _is_between(remainder, b, kind, known), _OPSET18.Sub(quotient, one), quotient
    )
    # Its rounding leaves almost whole numbers. Half a number more may be rounded to one more.
    floor = _OPSET18.Floor(quotient)
    is_below = _OPSET18.Greater(_OPSET18.Sub(quotient, floor), half)
    floor = _OPSET18.Where(is_below, _OPSET18.Add(floor, one), floor)
    if known:
        return floor
    return _OPSET18.Where(_OPSET18.Equal(b, zero), _OPSET18.Div(a, b), floor)


def _known_number(number: Any) -> float | None:
    """Return a number, also a whole one that torch casts to the type of the floats beside it."""
    if isinstance(number, int | float):
        return number
    cast = number.producer()
    if cast is None or cast.op_type != "Cast":
        return None
    constant = ir.convenience.get_const_tensor(cast.inputs[0])
    return None if constant is None or constant.size != 1 else float(constant.numpy().item())


def _is_power_of_two(number: float | None) -> bool:
    return number is not None and math.isfinite(number) and abs(math.frexp(number)[0]) == 0.5


def _is_between(remainder: Any, divisor: Any, kind: ir.DataType, known: float | None = None) -> Any:
    """Return where a remainder with the dividend's sign is not 0, and has not the divisor's sign.

    The divisor may be known.
    """
    (zero,) = _numbers(kind, 0.0)
    if known is not None:
        compare = _OPSET18.Greater if known < 0 else _OPSET18.Less
        return compare(remainder, zero)
    is_whole = _OPSET18.Equal(remainder, zero)
    differs = _OPSET18.Xor(_OPSET18.Less(remainder, zero), _OPSET18.Less(divisor, zero))
    return _OPSET18.And(_OPSET18.Not(is_whole), differs)


def _integer_quotient(a: Any, b: Any, kind: ir.DataType, *, is_floor: bool) -> Any:
    """Return the quotient of integers, rounded down or to zero, without a detour by floats."""
    wide = kind if kind == ir.DataType.INT32 else ir.DataType.INT64
    if kind != wide:
        a, b = (_OPSET18.Cast(number, to=int(wide)) for number in (a, b))
    quotient = _OPSET18.Div(a, b)
    if is_floor:
        is_below = _is_between(_OPSET18.Sub(a, _OPSET18.Mul(quotient, b)), b, wide)
        quotient = _OPSET18.Sub(quotient, _OPSET18.Cast(is_below, to=int(wide)))
    return quotient if kind == wide else _OPSET18.Cast(quotient, to=int(kind))


def _translate_division(a: Any, b: Any, rounding_mode: str | None = None) -> Any:
    """Translate ``div`` with a rounding mode."""
    if rounding_mode == "floor":
        return _translate_floor_division(a, b)
    a, b, kind = _promoted(a, b)
    if rounding_mode is None:
        result_kind = kind if kind.is_floating_point() else ir.DataType.FLOAT
        return _OPSET18.Div(*(_OPSET18.Cast(number, to=int(result_kind)) for number in (a, b)))
    if not kind.is_floating_point():
        return _integer_quotient(a, b, kind, is_floor=False)
    return _truncated(_OPSET18.Div(a, b))


def _translate_sign(values: Any) -> Any:
    """Translate ``sign`` and ``sgn``: NaN has the sign 0."""
    if values.dtype == ir.DataType.BOOL:
        return _OPSET18.Identity(values)
    sign = _OPSET18.Sign(values)
    if not values.dtype.is_floating_point():
        return sign
    (zero,) = _numbers(values.dtype, 0.0)
    return _OPSET18.Where(_OPSET18.IsNaN(values), zero, sign)


def _translate_angle(values: Any) -> Any:
    """Translate ``angle`` of real numbers: π below 0, NaN of NaN."""
    kind = values.dtype if values.dtype.is_floating_point() else ir.DataType.FLOAT
    values = _as_type(values, kind)
    zero, pi = _numbers(kind, 0.0, math.pi)
    angle = _OPSET18.Where(_OPSET18.Less(values, zero), pi, zero)
    return _OPSET18.Where(_OPSET18.IsNaN(values), values, angle)


def _translate_log_add_exp(base: float) -> Callable[..., Any]:
    """Return the translation of ``logaddexp``: large + log(1 + base^-distance) does not overflow."""

    def translate(a: Any, b: Any) -> Any:
        a, b, kind = _promoted(a, b)
        zero, one, factor = _numbers(kind, 0.0, 1.0, math.log(base))
        # Equal infinities have no difference.
        distance = _OPSET18.Where(_OPSET18.Equal(a, b), zero, _OPSET18.Abs(_OPSET18.Sub(a, b)))
        power = _OPSET18.Exp(_OPSET18.Neg(_OPSET18.Mul(distance, factor)))
        rest = _OPSET18.Div(_OPSET18.Log(_OPSET18.Add(one, power)), factor)
        return _OPSET18.Add(_OPSET18.Max(a, b), rest)

    return translate


def _translate_log_sigmoid(values: Any) -> Any:
    """Translate ``log_sigmoid`` to min(x, 0) - log(1 + exp(-|x|)): log(sigmoid(-100)) is -infinity."""
    zero, one = _numbers(values.dtype, 0.0, 1.0)
    power = _OPSET18.Exp(_OPSET18.Neg(_OPSET18.Abs(values)))
    return _OPSET18.Sub(_OPSET18.Min(values, zero), _OPSET18.Log(_OPSET18.Add(one, power)))


def _translate_for_floats(of_float: Callable[[Any], Any], of_integer: Callable[[Any], Any]) -> Any:
    """Return the translation of a function whose ONNX operator takes floats alone."""

    def translate(values: Any) -> Any:
        return (of_float if values.dtype.is_floating_point() else of_integer)(values)

    return translate


def _is_finite(values: Any) -> Any:
    """Return which floats are neither infinite nor NaN."""
    is_special = _OPSET18.Or(_OPSET18.IsInf(values), _OPSET18.IsNaN(values))
    return _OPSET18.Not(is_special)


def _is_equal_to_itself(values: Any) -> Any:
    return _OPSET18.Equal(values, values)


def _is_unequal_to_itself(values: Any) -> Any:
    return _OPSET18.Not(_OPSET18.Equal(values, values))


def _truncated(values: Any) -> Any:
    """Return floats rounded to zero."""
    return _OPSET18.Mul(_OPSET18.Sign(values), _OPSET18.Floor(_OPSET18.Abs(values)))


_aten, _prims = torch.ops.aten, torch.ops.prims

NUMBER_TRANSLATIONS: Final[dict[Callable[..., Any], Callable[..., Any]]] = {
    _prims.scalar_tensor.default: _translate_scalar,
    _prims.hypot.default: _translate_hypot,
    _prims.fmax.default: _translate_number_extreme("Max"),
    _prims.fmin.default: _translate_number_extreme("Min"),
    _aten.signbit.default: _translate_signbit,
    _aten.sign.default: _translate_sign,
    _aten.sgn.default: _translate_sign,
    _aten.angle.default: _translate_angle,
    _aten.atan2.default: _translate_atan2,
    _aten.logaddexp.default: _translate_log_add_exp(math.e),
    _aten.logaddexp2.default: _translate_log_add_exp(2.0),
    _aten.log_sigmoid.default: _translate_log_sigmoid,
    _aten.floor.default: _translate_for_floats(_OPSET18.Floor, _OPSET18.Identity),
    _aten.ceil.default: _translate_for_floats(_OPSET18.Ceil, _OPSET18.Identity),
    _aten.round.default: _translate_for_floats(_OPSET18.Round, _OPSET18.Identity),
    _aten.trunc.default: _translate_for_floats(_truncated, _OPSET18.Identity),
    _aten.isfinite.default: _translate_for_floats(_is_finite, _is_equal_to_itself),
    _aten.isnan.default: _translate_for_floats(_OPSET18.IsNaN, _is_unequal_to_itself),
    _aten.copysign.Tensor: _translate_copysign,
    _aten.copysign.Scalar: _translate_copysign,
    _aten.remainder.Tensor: _translate_remainder,
    _aten.remainder.Scalar: _translate_remainder,
    _aten.remainder.Scalar_Tensor: _translate_remainder,
    _aten.floor_divide.default: _translate_floor_division,
    _aten.floor_divide.Scalar: _translate_floor_division,
    _aten.div.Tensor_mode: _translate_division,
    _aten.div.Scalar_mode: _translate_division,
    _aten.pow.Tensor_Tensor: _translate_power,
    _aten.pow.Tensor_Scalar: _translate_power,
    _aten.pow.Scalar: _translate_power,
}
