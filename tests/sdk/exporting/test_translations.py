"""Operators that torch's exporter does not translate, run by ONNX Runtime against torch."""

import operator
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
import onnx_ir as ir
import onnxruntime
import pytest
import torch

from gsgen.contract.probing.probes import Probe
from gsgen.sdk.exporting.tracing.trace import TensorNames, trace_module

EDGES = torch.tensor([[-1.0, 0.0, 0.5, 0.5, 2.0], [-2.0, -2.0, 0.0, 1.0, 3.0]])


def exported_results(
    module: torch.nn.Module, x: torch.Tensor, names: list[str]
) -> list[np.ndarray]:
    """Export a module, and return what ONNX Runtime computes of ``x``."""
    probe = Probe(label="x", inputs={"x": x.numpy()})
    where = type(module).__name__
    model = trace_module(module, probe, TensorNames(("x",), tuple(names)), 18, where=where)
    data = ir.serde.serialize_model(model).SerializeToString()
    results: list[np.ndarray] = onnxruntime.InferenceSession(data).run(None, {"x": x.numpy()})
    return results


class Untranslated(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return (
            torch.searchsorted(EDGES[0], x),
            torch.searchsorted(EDGES[0], x, right=True),
            torch.searchsorted(EDGES, x, side="right"),
            torch.cumprod(x, dim=1),
            torch.cumprod(x, dim=0),
        )


def test_translations_give_what_torch_gives() -> None:
    x = torch.randn(2, 7, generator=torch.Generator().manual_seed(0))
    x[0, :5] = EDGES[0]  # values on an edge: left and right differ
    results = exported_results(Untranslated(), x, ["left", "right", "rows", "across", "down"])
    for result, expected in zip(results, Untranslated()(x), strict=True):
        assert result.dtype == expected.numpy().dtype
        np.testing.assert_allclose(result, expected.numpy(), rtol=1e-6)


REDUCTIONS = (
    *("sum", "mean", "prod", "amax", "amin", "max", "min", "std", "var", "norm", "logsumexp"),
    *("nansum", "nanmean", "argmax", "argmin", "any", "all", "count_nonzero", "aminmax"),
    *("std_mean", "var_mean"),
)
DIMENSIONS: tuple[Any, ...] = (None, 0, -1, (0, 2), (0, 1, 2), ())
CUBE = torch.randn(2, 3, 4, generator=torch.Generator().manual_seed(0))

Reduction = Callable[[torch.Tensor], tuple[torch.Tensor, ...]]


def reduction_calls(name: str) -> Iterator[tuple[str, Reduction]]:
    """Yield a reduction with all dimensions, with and without keeping them, that torch accepts."""
    for dims, keepdim in product(DIMENSIONS, (False, True)):
        options = ({} if dims is None else {"dim": dims}) | ({"keepdim": True} if keepdim else {})

        def call(x: torch.Tensor, options: dict[str, Any] = options) -> tuple[torch.Tensor, ...]:
            result = getattr(torch, name)(x > 0 if name in ("any", "all") else x, **options)
            return tuple(result) if isinstance(result, tuple) else (result,)

        try:
            call(CUBE)
        except (IndexError, RuntimeError, TypeError):
            continue
        yield f"{name}({options})", call


class Reduced(torch.nn.Module):
    """All results of several reductions."""

    def __init__(self, calls: list[Reduction]) -> None:
        super().__init__()
        self.calls = calls

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return tuple(part for call in self.calls for part in call(x))


def test_reductions_give_what_torch_gives_for_all_dimensions() -> None:
    calls = dict(entry for name in REDUCTIONS for entry in reduction_calls(name))
    assert len(calls) > 150
    module = Reduced(list(calls.values()))
    expected = module(CUBE)
    names = [f"{name} {n}" for name, call in calls.items() for n, _ in enumerate(call(CUBE))]
    results = exported_results(module, CUBE, names)
    for name, result, tensor in zip(names, results, expected, strict=True):
        assert result.shape == tuple(tensor.shape), name
        np.testing.assert_allclose(result, tensor.numpy(), rtol=1e-5, err_msg=name)


class Scattered(torch.nn.Module):
    """All reductions of scatter_reduce and index_reduce, along both dimensions."""

    rows = torch.tensor([0, 2, 0, 3])
    columns = torch.tensor([1, 1, 0])

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        target, results = torch.full((5, 3), 0.5), []
        for name, include_self in product(("sum", "mean", "prod", "amax", "amin"), (False, True)):
            for dim, index in (
                (0, self.rows[:, None].expand(4, 3)),
                (1, self.columns.expand(4, 3)),
            ):
                results.append(
                    target.scatter_reduce(dim, index, x, name, include_self=include_self)
                )
            if name != "sum":
                results.append(
                    target.index_reduce(0, self.rows, x, name, include_self=include_self)
                )
        return tuple(results)


@pytest.mark.filterwarnings("ignore:index_reduce:UserWarning")
def test_reductions_by_index_give_what_torch_gives() -> None:
    x = torch.randn(4, 3, generator=torch.Generator().manual_seed(0))
    expected = Scattered()(x)
    results = exported_results(Scattered(), x, [f"result_{n}" for n in range(len(expected))])
    for result, tensor in zip(results, expected, strict=True):
        np.testing.assert_allclose(result, tensor.numpy(), rtol=1e-5)


NUMBERS = torch.tensor([3.0, 1.0, 2.0, 0.0, -2.0])
DTYPES = (*(torch.float32, torch.float64, torch.int64, torch.int32, torch.uint8), torch.bool)
SCALARS: tuple[float, ...] = (0, 2, 3, -1, 0.5, 2.0)
Call = Callable[[torch.Tensor], torch.Tensor]


def cast_call(
    function: Callable[[Any, Any], Any], dtype: torch.dtype, numbers: Any, other: Any
) -> Call:
    """Return a function of numbers that an input scales, and of another operand."""
    return lambda x: function((numbers * x).to(dtype), other)


def binary_calls() -> Iterator[tuple[str, Call]]:
    """Yield operators of two dtypes, of a dtype and a number, and of a number and a dtype."""
    base, exponent = NUMBERS.abs(), torch.tensor([0.0, 2.0, 3.0, 1.0, 2.0])
    for first, second in product(DTYPES, DTYPES):
        yield f"{first} ** {second}", cast_call(operator.pow, first, base, exponent.to(second))
    for dtype, number in product(DTYPES, SCALARS):
        yield f"{dtype} ** {number!r}", cast_call(operator.pow, dtype, base + 1, number)
        reverse = cast_call(lambda a, b: b**a, dtype, exponent, number)
        yield f"{number!r} ** {dtype}", reverse
    yield "bfloat16 ** 0.5", lambda x: ((base * x).bfloat16() ** 0.5).float()
    negative = torch.tensor([-1, -2, -3, -1, -2])
    for dtype in DTYPES[2:4]:
        yield f"{dtype} ** -n", cast_call(operator.pow, dtype, NUMBERS - 1, negative.to(dtype))
    for dtype, number in product(DTYPES[:5], (-0.0, -3, 2.5)):
        yield f"copysign {dtype} {number!r}", cast_call(torch.copysign, dtype, base, number)
    nan, inf = float("nan"), float("inf")
    numbers = torch.tensor([3.0, 1e30, 1e-30, 0.0, -2.0, nan, inf, inf, nan])
    others = torch.tensor([-0.0, 1e30, 1e-30, 0.0, nan, 0.5, nan, -inf, nan])
    for name, dtype in product(("copysign", "hypot", "fmax", "fmin"), DTYPES[:2]):
        yield f"{name} {dtype}", cast_call(getattr(torch, name), dtype, numbers, others.to(dtype))


class Called(torch.nn.Module):
    """The results of several calls."""

    def __init__(self, calls: list[Call]) -> None:
        super().__init__()
        self.calls = calls

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return tuple(call(x) for call in self.calls)


def is_defined(call: Call) -> bool:
    """Return whether torch computes a call."""
    try:
        call(torch.ones(1))
    except (NotImplementedError, RuntimeError):
        return False
    return True


def test_operators_of_two_dtypes_give_what_torch_gives() -> None:
    calls = {name: call for name, call in binary_calls() if is_defined(call)}
    assert len(calls) > 90
    x = torch.ones(1)
    module = Called(list(calls.values()))
    results = exported_results(module, x, list(calls))
    for name, result, tensor in zip(calls, results, module(x), strict=True):
        expected = tensor.numpy()
        assert result.dtype == expected.dtype, name
        np.testing.assert_allclose(result, expected, rtol=1e-5, err_msg=name)
