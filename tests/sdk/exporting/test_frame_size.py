from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.targets import load_target
from gsgen.sdk import GaussianGenerator, Gaussians, GeneratorInvalid, export, inputs
from gsgen.sdk.exporting import frame_size
from support.models.generators import Drift, Lit

BINDING = 1 << 20


class Crowd(GaussianGenerator):
    """A torch module of many equal Gaussians."""

    inputs = (inputs.time(range=(0, 1)),)

    def __init__(self, rows: int, coefficients: int) -> None:
        super().__init__()
        self.rows, self.coefficients = rows, coefficients

    def forward(self, time: torch.Tensor) -> Gaussians:
        ones = torch.ones(self.rows, 1)
        sh = torch.zeros(self.rows, self.coefficients, 3)
        rotation = torch.tensor([[1.0, 0, 0, 0]]).repeat(self.rows, 1)
        position = torch.arange(self.rows)[:, None] * torch.ones(3) + time
        return Gaussians(position, 0.5 * ones, 0.1 * torch.ones(self.rows, 3), rotation, sh=sh)


class Turning(Drift):
    """A few Gaussians that go around the z axis once."""

    def __init__(self) -> None:
        super().__init__(n=8, degree=0)

    def forward(self, time: torch.Tensor) -> Gaussians:
        angle = 2 * torch.pi * time
        cosine, sine, zero = torch.cos(angle), torch.sin(angle), torch.zeros(1)
        half = torch.cat([torch.cos(angle / 2), zero, zero, torch.sin(angle / 2)])
        turn = torch.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, zero + 1])
        position = self.rest @ turn.reshape(3, 3).T
        return Gaussians(position, self.opacity, self.scale, half.repeat(8, 1), sh=self.sh)


@pytest.mark.parametrize(
    ("coefficients", "hint"),
    [(16, "Export with --dtype float16 or --keep 1000."), (1, "Export with --keep 1000.")],
)
def test_a_frame_that_the_target_cannot_bind_is_refused_at_once(
    tmp_path: Path, monkeypatch, coefficients: int, hint: str
) -> None:
    webgpu = load_target("webgpu")
    assert webgpu.limits["binding_bytes"] == 128 << 20
    small = replace(webgpu, limits={**webgpu.limits, "binding_bytes": BINDING})
    monkeypatch.setattr(frame_size, "load_target", {"webgpu": small}.__getitem__)
    # Degree 3: color is largest and halves below the limit. Degree 0: rows are, and do not.
    numbers = 48 if coefficients == 16 else 10
    rows = BINDING // (4 * numbers) + 1 if coefficients == 16 else BINDING // (2 * numbers) + 1
    generator = Crowd(rows, coefficients)
    generator.smaller = ("--keep 1000",)
    steps: list[str] = []
    with pytest.raises(GeneratorInvalid, match="binds at most 1 MiB") as caught:
        export(generator, tmp_path / "m.onnx", target="webgpu", progress=steps.append)
    assert caught.value.hint == hint
    assert caught.value.where == "Crowd"
    assert steps == ["running the module in eager torch"]
    assert list(tmp_path.iterdir()) == []


def test_the_size_of_a_large_frame_is_told_before_the_long_part(
    tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(frame_size, "_LARGE_FRAME_BYTES", 50 * (10 + 48) * 4)
    steps: list[str] = []
    exported = export(Drift(), tmp_path / "m.onnx", progress=steps.append)
    (message,) = [step for step in steps if "Gaussians:" in step]
    assert message.startswith("50 Gaussians: ")
    assert "40 runs" in message
    assert steps.index(message) == 1
    assert frame_size.frame_bytes(exported.manifest) == 50 * (10 + 48) * 4


def test_a_small_frame_needs_no_estimate(tmp_path: Path) -> None:
    steps: list[str] = []
    export(Drift(), tmp_path / "m.onnx", progress=steps.append)
    assert not [step for step in steps if "Gaussians:" in step]


def test_a_quick_comparison_takes_fewer_probes(tmp_path: Path) -> None:
    full = export(Drift(), tmp_path / "full.onnx")
    quick_export = export(Drift(), tmp_path / "quick.onnx", verify="quick")
    assert (full.parity.probes, quick_export.parity.probes) == (13, 7)


def test_a_quick_comparison_measures_the_bounds_of_a_turning_model_at_every_probe(
    tmp_path: Path,
) -> None:
    """Opposite times of a whole turn see two points of the circle: bounds need the others, too."""
    quick_export = export(Turning(), tmp_path / "quick.onnx", verify="quick")
    assert quick_export.parity.probes == 7
    assert quick_export.manifest.bounds == export(Turning(), tmp_path / "full.onnx").manifest.bounds


@pytest.mark.parametrize(("kind", "dtype"), [(Lit, "float16"), (Drift, "float32")])
def test_the_dtype_follows_a_target_that_reads_one_alone(
    tmp_path: Path, kind: type[GaussianGenerator], dtype: str
) -> None:
    exported = export(kind(), tmp_path / "m.onnx", target="visionary")
    assert exported.dtype == dtype
    text = open_model(tmp_path / "m.onnx").manifest_text
    assert text is not None
    assert loads(text).outputs == exported.manifest.outputs
    assert export(kind(), tmp_path / "core.onnx").dtype == "float32"
