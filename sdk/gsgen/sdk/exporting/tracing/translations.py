"""ONNX forms of torch operators that torch's own exporter does not translate, or gets wrong."""

__all__ = ["OPERATOR_TRANSLATIONS"]

from collections.abc import Callable, Sequence
from typing import Any, Final

import torch
from onnx import TensorProto
from onnxscript import opset18
from onnxscript.function_libs.torch_lib.ops.linalg import aten_linalg_vector_norm

from gsgen.sdk.exporting.tracing.number_translations import NUMBER_TRANSLATIONS

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

    def translate(
        values: Any, dim: int | Sequence[int] | None = None, keepdim: bool = False
    ) -> Any:
        truth = _OPSET18.Cast(values, to=TensorProto.BOOL)
        dims = [dim] if isinstance(dim, int) else dim
        if dims is not None and not dims:
            return truth
        axes = [] if dims is None else [_OPSET18.Constant(value_ints=list(dims))]
        numbers = _OPSET18.Cast(truth, to=TensorProto.INT32)
        extreme = getattr(_OPSET18, operator)(numbers, *axes, keepdims=int(keepdim))
        # Of no numbers, the largest is below 0 and the smallest above 1.
        zero = _OPSET18.Cast(_OPSET18.Constant(value_int=0), to=TensorProto.INT32)
        return _OPSET18.Greater(extreme, zero)

    return translate


def _translate_stable_sort(
    values: Any, stable: bool | None = None, dim: int = -1, descending: bool = False
) -> Any:
    """Translate ``sort``: of equal numbers, TopK puts the one with the lower index first."""
    axis = _OPSET18.Constant(value_ints=[dim])
    size = _OPSET18.Gather(_OPSET18.Shape(values), axis, axis=0)
    return _OPSET18.TopK(values, size, axis=dim, largest=int(descending), sorted=1)


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


OPERATOR_TRANSLATIONS: Final[dict[Callable[..., Any], Callable[..., Any]]] = {
    **NUMBER_TRANSLATIONS,
    torch.ops.aten.searchsorted.Tensor: _translate_searchsorted,
    torch.ops.prims.prod.default: _translate_prod,
    torch.ops.aten.amax.default: _translate_extreme("ReduceMax"),
    torch.ops.aten.amin.default: _translate_extreme("ReduceMin"),
    torch.ops.aten.argmax.default: _translate_position("ArgMax"),
    torch.ops.aten.argmin.default: _translate_position("ArgMin"),
    torch.ops.aten.sort.stable: _translate_stable_sort,
    torch.ops.aten.any.default: _translate_truth("ReduceMax"),
    torch.ops.aten.all.default: _translate_truth("ReduceMin"),
    torch.ops.aten.any.dim: _translate_truth("ReduceMax"),
    torch.ops.aten.all.dim: _translate_truth("ReduceMin"),
    torch.ops.aten.any.dims: _translate_truth("ReduceMax"),
    torch.ops.aten.all.dims: _translate_truth("ReduceMin"),
    torch.ops.aten.linalg_vector_norm.default: _translate_vector_norm,
    torch.ops.aten.select_scatter.default: _translate_select_scatter,
    torch.ops.aten.scatter_reduce.two: _translate_scatter_reduce,
    torch.ops.aten.index_reduce.default: _translate_index_reduce,
}
