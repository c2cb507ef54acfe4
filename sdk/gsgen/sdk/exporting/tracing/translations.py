"""ONNX forms of torch operators that torch's own exporter does not translate, or gets wrong."""

__all__ = ["OPERATOR_TRANSLATIONS"]

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import onnx_ir as ir
import torch
from onnx import TensorProto
from onnx_ir.tensor_adapters import from_torch_dtype, to_torch_dtype
from onnxscript import opset18
from onnxscript.function_libs.torch_lib.ops.linalg import aten_linalg_vector_norm

# Its types are those of single operators, not of what they return.
_OPSET18: Any = opset18

# torch's name of a reduction → ONNX's, and the number that leaves every other as it is.
_SCATTER_REDUCTIONS: Final = {
    "sum": ("add", 0.0),
    "mean": ("add", 0.0),
    "prod": ("mul", 1.0),
    "amax": ("max", float("-inf")),
    "amin": ("min", float("inf")),
}


def _translate_searchsorted(
    boundaries: Any, values: Any, *, right: bool = False, side: str | None = None, **_: Any
) -> Any:
    """Translate searchsorted to float32 counts of boundaries; WebGPU cannot sum int64."""
    expanded_values = _OPSET18.Unsqueeze(values, _OPSET18.Constant(value_ints=[-1]))
    row = _OPSET18.Unsqueeze(boundaries, _OPSET18.Constant(value_ints=[-2]))
    is_right_side = right or side == "right"
    is_below = (
        _OPSET18.LessOrEqual(row, expanded_values)
        if is_right_side
        else _OPSET18.Less(row, expanded_values)
    )
    ones = _OPSET18.Cast(is_below, to=TensorProto.FLOAT)
    count = _OPSET18.ReduceSum(ones, _OPSET18.Constant(value_ints=[-1]), keepdims=0)
    return _OPSET18.Cast(count, to=TensorProto.INT64)


def _translate_prod(values: Any, dims: Sequence[int], **_: Any) -> Any:
    """Translate ``prims.prod``, to which torch reduces ``cumprod``, to the operator ReduceProd."""
    axes = _OPSET18.Constant(value_ints=list(dims))
    return _OPSET18.ReduceProd(values, axes, keepdims=0)


def _translate_extreme(operator: str) -> Callable[..., Any]:
    """Return the translation of ``amax`` or ``amin``, whose dimensions may be absent: all of them."""

    def translate(values: Any, dim: Sequence[int] = (), keepdim: bool = False) -> Any:
        reduce = getattr(_OPSET18, operator)
        keepdims = int(keepdim)
        if not dim:
            return reduce(values, keepdims=keepdims)
        return reduce(values, _OPSET18.Constant(value_ints=list(dim)), keepdims=keepdims)

    return translate


def _translate_position(operator: str) -> Callable[..., Any]:
    """Return the translation of ``argmax`` or ``argmin``, which count all elements without a dimension."""

    def translate(values: Any, dim: int | None = None, keepdim: bool = False) -> Any:
        reduce = getattr(_OPSET18, operator)
        if dim is not None:
            return reduce(values, axis=dim, keepdims=int(keepdim))
        row = _OPSET18.Reshape(values, _OPSET18.Constant(value_ints=[-1]))
        position = reduce(row, axis=0, keepdims=0)
        sizes = [1] * len(values.shape) if keepdim else []
        return _OPSET18.Reshape(position, _OPSET18.Constant(value_ints=sizes))

    return translate


def _translate_truth(operator: str) -> Callable[..., Any]:
    """Return the translation of ``any`` or ``all``: an empty list of dimensions reduces none."""

    def translate(values: Any, dim: Sequence[int] | None = None, keepdim: bool = False) -> Any:
        truth = _OPSET18.Cast(values, to=TensorProto.BOOL)
        if dim is not None and not dim:
            return truth
        axes = [] if dim is None else [_OPSET18.Constant(value_ints=list(dim))]
        numbers = _OPSET18.Cast(truth, to=TensorProto.INT32)
        extreme = getattr(_OPSET18, operator)(numbers, *axes, keepdims=int(keepdim))
        return _OPSET18.Cast(extreme, to=TensorProto.BOOL)

    return translate


def _translate_vector_norm(
    values: Any, ord: float = 2.0, dim: Any = None, keepdim: bool = False, dtype: int = -1
) -> Any:
    """Translate ``vector_norm``, whose dimensions may be absent although it keeps them."""
    if dim is None and keepdim:
        dim = list(range(len(values.shape)))
    return aten_linalg_vector_norm(values, ord, dim, keepdim, dtype)


def _translate_select_scatter(target: Any, source: Any, dim: int, index: int) -> Any:
    """Translate ``x[:, 0] = y`` to a choice by a constant mask; torch's own scatters each element."""
    rank = len(target.shape)
    axis, size = dim % rank, target.shape[dim]
    is_written = [int(position == index % size) for position in range(size)]
    shape = [size if position == axis else 1 for position in range(rank)]
    flags = _OPSET18.Cast(_OPSET18.Constant(value_ints=is_written), to=TensorProto.BOOL)
    mask = _OPSET18.Reshape(flags, _OPSET18.Constant(value_ints=shape))
    values = _OPSET18.Unsqueeze(source, _OPSET18.Constant(value_ints=[axis]))
    return _OPSET18.Where(mask, _OPSET18.CastLike(values, target), target)


def _translate_scatter_reduce(
    target: Any, dim: int, index: Any, source: Any, reduce: str, include_self: bool = True
) -> Any:
    """Translate scatter_reduce; the mean is a sum, divided by the number of its terms."""
    reduction, neutral = _SCATTER_REDUCTIONS[reduce]
    shape = _OPSET18.Shape(index)

    def filled(number: float) -> Any:
        constant = _OPSET18.CastLike(_OPSET18.Constant(value_float=number), target)
        return _OPSET18.Expand(constant, shape)

    start = target
    if not include_self:
        start = _OPSET18.ScatterElements(target, index, filled(neutral), axis=dim)
    total = _OPSET18.ScatterElements(start, index, source, axis=dim, reduction=reduction)
    if reduce != "mean":
        return total
    one = _OPSET18.CastLike(_OPSET18.Constant(value_float=1.0), target)
    zeros = _OPSET18.Mul(target, _OPSET18.Sub(one, one))
    terms = _OPSET18.Add(zeros, one) if include_self else zeros
    count = _OPSET18.ScatterElements(terms, index, filled(1.0), axis=dim, reduction="add")
    return _OPSET18.Div(total, _OPSET18.Max(count, one))


def _translate_index_reduce(
    target: Any, dim: int, index: Any, source: Any, reduce: str, include_self: bool = True
) -> Any:
    """Translate index_reduce, whose index counts for all elements of a row, to scatter_reduce."""
    rank = len(source.shape)
    axes = [axis for axis in range(rank) if axis != dim % rank]
    expanded = _OPSET18.Unsqueeze(index, _OPSET18.Constant(value_ints=axes)) if axes else index
    indices = _OPSET18.Expand(expanded, _OPSET18.Shape(source))
    return _translate_scatter_reduce(target, dim, indices, source, reduce, include_self)


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


def _translate_power(base: Any, exponent: Any) -> Any:
    """Translate ``pow``: ONNX gives the result the base's type, torch the type of both together."""
    promoted = torch.result_type(_promotable(base), _promotable(exponent))
    result_type = from_torch_dtype(promoted)
    other_type = ir.DataType.FLOAT if promoted.is_floating_point else ir.DataType.INT64
    power_type = result_type if result_type in _POWER_TYPES else other_type

    def cast(number: Any) -> Any:
        if isinstance(number, int | float):
            number = _OPSET18.Constant(value=ir.tensor(number, power_type))
        elif number.dtype != power_type:
            number = _OPSET18.Cast(number, to=int(power_type))
        return number

    base, exponent = cast(base), cast(exponent)
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
    is_negative = _is_negative(_OPSET18.Cast(sign, to=code))
    return _OPSET18.Where(is_negative, _OPSET18.Neg(size), size)


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


OPERATOR_TRANSLATIONS: Final[dict[Callable[..., Any], Callable[..., Any]]] = {
    torch.ops.aten.searchsorted.Tensor: _translate_searchsorted,
    torch.ops.prims.scalar_tensor.default: _translate_scalar,
    torch.ops.prims.prod.default: _translate_prod,
    torch.ops.prims.hypot.default: _translate_hypot,
    torch.ops.prims.fmax.default: _translate_number_extreme("Max"),
    torch.ops.prims.fmin.default: _translate_number_extreme("Min"),
    torch.ops.aten.signbit.default: _translate_signbit,
    torch.ops.aten.copysign.Tensor: _translate_copysign,
    torch.ops.aten.copysign.Scalar: _translate_copysign,
    torch.ops.aten.pow.Tensor_Tensor: _translate_power,
    torch.ops.aten.pow.Tensor_Scalar: _translate_power,
    torch.ops.aten.pow.Scalar: _translate_power,
    torch.ops.aten.amax.default: _translate_extreme("ReduceMax"),
    torch.ops.aten.amin.default: _translate_extreme("ReduceMin"),
    torch.ops.aten.argmax.default: _translate_position("ArgMax"),
    torch.ops.aten.argmin.default: _translate_position("ArgMin"),
    torch.ops.aten.any.dims: _translate_truth("ReduceMax"),
    torch.ops.aten.all.dims: _translate_truth("ReduceMin"),
    torch.ops.aten.linalg_vector_norm.default: _translate_vector_norm,
    torch.ops.aten.select_scatter.default: _translate_select_scatter,
    torch.ops.aten.scatter_reduce.two: _translate_scatter_reduce,
    torch.ops.aten.index_reduce.default: _translate_index_reduce,
}
