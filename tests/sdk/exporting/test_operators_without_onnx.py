"""Operators without ONNX form, and arithmetic below float32: the line, the cause, what to write."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from gsgen.contract.probing.probes import Probe
from gsgen.sdk import GaussianGenerator, Gaussians, export, inputs
from gsgen.sdk.errors import ExportFailed, ParityFailed
from gsgen.sdk.exporting.tracing.trace import TensorNames, trace_module

COUNT = 48


class Cloud(GaussianGenerator):
    """A cloud whose positions a function of positions and time moves."""

    inputs = (inputs.time(range=(0, 1)),)

    def __init__(self, move: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(1)
        self.rest = nn.Parameter(torch.randn(COUNT, 3, generator=generator))
        self.move = move

    def forward(self, time: Tensor) -> Gaussians:
        moved = self.move(self.rest + time)
        return Gaussians(
            position=self.rest + 0.1 * moved,
            opacity=torch.full((COUNT,), 0.8),
            scale=torch.full((COUNT, 3), 0.3),
            rotation=torch.tensor([[1.0, 0, 0, 0]]).repeat(COUNT, 1),
            rgb=torch.sigmoid(self.rest),
        )


def cummax(x: Tensor) -> Tensor:
    return torch.cummax(x, 0)[0]


# Each on its own line.
OPERATORS: tuple[Callable[[Tensor], Tensor], ...] = (
    lambda x: x.cummin(0)[0],
    lambda x: x - x.median(0)[0],
    lambda x: x - torch.kthvalue(x, 3, 0)[0],
    lambda x: x - torch.mode(x, 0)[0],
    lambda x: x + torch.histc(x, 3),
    lambda x: torch.erfinv(0.5 * torch.tanh(x)),
    lambda x: torch.special.ndtri(0.5 + 0.4 * torch.tanh(x)),
    lambda x: torch.mvlgamma(x.abs() + 3, 2),
    lambda x: torch.polygamma(1, x.abs() + 1),
    lambda x: torch.special.bessel_j0(x),
    lambda x: torch.special.i1e(x),
    lambda x: torch.i0(x),
    lambda x: torch.igamma(x.abs() + 1, x.abs() + 1),
    lambda x: torch.special.zeta(x.abs() + 2, x.abs()),
    lambda x: torch.nextafter(x, x + 1),
    lambda x: torch.frexp(x)[0],
    lambda x: torch.lcm(x.long(), x.long() + 3),
)


class Moved(nn.Module):
    """A function of an input."""

    def __init__(self, move: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self.move = move

    def forward(self, x: Tensor) -> Tensor:
        return self.move(x)


@pytest.mark.slow
@pytest.mark.parametrize("move", OPERATORS)
def test_an_operator_without_onnx_form_is_named_with_its_line(
    move: Callable[[Tensor], Tensor],
) -> None:
    probe = Probe(label="x", inputs={"x": np.linspace(-2, 2, 12, dtype=np.float32).reshape(4, 3)})
    with pytest.raises(ExportFailed) as caught:
        trace_module(Moved(move), probe, TensorNames(("x",), ("y",)), 18, where="Moved")
    error = caught.value
    line = move.__code__.co_firstlineno
    assert error.where.startswith(f"test_operators_without_onnx.py:{line} (lambda x: "), str(error)
    assert re.match(r"(ONNX has no operator for|torch cannot write) torch\.", error.message)
    assert "ONNX has (arithmetic" in error.hint


def test_a_running_maximum_is_named_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(ExportFailed, match=r"ONNX has no operator for torch\.cummax") as caught:
        export(Cloud(cummax), tmp_path / "model.onnx")
    assert "(return torch.cummax(x, 0)[0])" in caught.value.where
    assert "triangular mask" in caught.value.hint


def half_layers(dtype: torch.dtype) -> Callable[[Tensor], Tensor]:
    torch.manual_seed(0)
    layers = nn.Sequential(nn.Linear(3, 64), nn.ReLU(), nn.Linear(64, 3)).to(dtype)

    def move(x: Tensor) -> Tensor:
        return 9 * layers(x.to(dtype)).float()

    return move


def half_sine(dtype: torch.dtype) -> Callable[[Tensor], Tensor]:
    def move(x: Tensor) -> Tensor:
        return 9 * torch.sin(40 * x.to(dtype)).float()

    return move


def half_sum(dtype: torch.dtype) -> Callable[[Tensor], Tensor]:
    def move(x: Tensor) -> Tensor:
        return x + x.to(dtype).mul(3.3).cumsum(0).float()

    return move


def half_weights(dtype: torch.dtype) -> Callable[[Tensor], Tensor]:
    weights = torch.randn(3, 3, generator=torch.Generator().manual_seed(0)).to(dtype)

    def move(x: Tensor) -> Tensor:
        return 30 * (x.to(dtype) @ weights).float()

    return move


@pytest.mark.slow
@pytest.mark.parametrize("make", [half_layers, half_sine, half_sum, half_weights])
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_arithmetic_below_float32_is_named_with_its_line(
    make: Callable[[torch.dtype], Callable[[Tensor], Tensor]], dtype: torch.dtype, tmp_path: Path
) -> None:
    """Either the model agrees with torch, or the error names the line, the type and .float()."""
    try:
        export(Cloud(make(dtype)), tmp_path / "model.onnx")
    except ParityFailed as error:
        name = str(dtype).removeprefix("torch.")
        assert "test_operators_without_onnx.py:" in error.hint  # noqa: PT017
        assert f"computes in {name}" in error.hint  # noqa: PT017
        assert ".float()" in error.hint  # noqa: PT017


def test_weights_below_float32_that_are_converted_are_exported(tmp_path: Path) -> None:
    """Stored types alone change nothing: values are exact in float32."""
    weights = torch.randn(COUNT, 3, generator=torch.Generator().manual_seed(0)).bfloat16()
    export(Cloud(lambda x: x * weights.float()), tmp_path / "model.onnx")
    assert (tmp_path / "model.onnx").exists()
