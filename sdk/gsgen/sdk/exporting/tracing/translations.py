"""ONNX forms of torch operators that torch's own exporter does not translate."""

__all__ = ["TRANSLATIONS"]

from collections.abc import Callable, Sequence
from typing import Any

import torch
from onnx import TensorProto
from onnxscript import opset18

# Its types are those of single operators, not of what they return.
_OP: Any = opset18


def _searchsorted(
    boundaries: Any, values: Any, *, right: bool = False, side: str | None = None, **_: Any
) -> Any:
    """Translate searchsorted to float32 counts of boundaries; WebGPU cannot sum int64."""
    each = _OP.Unsqueeze(values, _OP.Constant(value_ints=[-1]))
    row = _OP.Unsqueeze(boundaries, _OP.Constant(value_ints=[-2]))
    is_right = right or side == "right"
    is_below = _OP.LessOrEqual(row, each) if is_right else _OP.Less(row, each)
    ones = _OP.Cast(is_below, to=TensorProto.FLOAT)
    count = _OP.ReduceSum(ones, _OP.Constant(value_ints=[-1]), keepdims=0)
    return _OP.Cast(count, to=TensorProto.INT64)


def _prod(values: Any, dims: Sequence[int], **_: Any) -> Any:
    """Translate ``prims.prod``, to which torch reduces ``cumprod``, to the operator ReduceProd."""
    axes = _OP.Constant(value_ints=list(dims))
    return _OP.ReduceProd(values, axes, keepdims=0)


TRANSLATIONS: dict[Callable[..., Any], Callable[..., Any]] = {
    torch.ops.aten.searchsorted.Tensor: _searchsorted,
    torch.ops.prims.prod.default: _prod,
}
