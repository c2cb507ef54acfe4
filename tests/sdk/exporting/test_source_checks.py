"""Numbers that are wrong in eager torch are named as such, with their field and test inputs."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from gsgen.sdk import Cells, Gaussians, GeneratorInvalid, export, math
from gsgen.sdk.exporting.source_checks import check_gaussians
from support.models.generators import Drift

_ZERO_QUATERNIONS = torch.zeros(8, 4)


def scene(**changes: Tensor | Cells) -> Gaussians:
    """Return eight Gaussians that pass every check, with some fields changed."""
    defaults: dict[str, Tensor] = {
        "position": torch.arange(24.0).reshape(8, 3),
        "opacity": torch.full((8,), 0.5),
        "scale": torch.full((8, 3), 0.1),
        "rotation": torch.tensor([[1.0, 0, 0, 0]]).repeat(8, 1),
        "rgb": torch.full((8, 3), 0.5),
    }
    return Gaussians(**(defaults | changes))  # type: ignore[arg-type]


def with_rows(field: str, rows: slice, value: float) -> Gaussians:
    """Return the usual Gaussians, of which some rows of one field have another value."""
    changed = getattr(scene(), field).clone()
    changed[rows] = value
    return scene(**{field: changed})


@pytest.mark.parametrize("field", ["position", "opacity", "scale", "rotation", "rgb"])
@pytest.mark.parametrize(("value", "kind"), [(torch.nan, "NaN"), (-torch.inf, "infinity")])
def test_numbers_that_are_not_finite_are_named_with_their_field(
    field: str, value: float, kind: str
) -> None:
    with pytest.raises(GeneratorInvalid) as caught:
        check_gaussians(with_rows(field, slice(6, 8), value), 8, "time=0")
    assert caught.value.where == f"Gaussians.{field}"
    assert (
        str(caught.value)
        .splitlines()[0]
        .endswith(f"{kind} in 2 of 8 rows at 'time=0'; expected finite numbers")
    )
    assert "clamp" in caught.value.hint


def test_rows_behind_the_count_may_hold_anything() -> None:
    check_gaussians(with_rows("position", slice(6, 8), torch.nan), 6, "time=0")


def test_cells_are_checked_as_gaussians_are() -> None:
    cells = Cells(
        position=torch.full((2, 3), torch.nan),
        visibility=torch.ones(2, 1),
        scale=torch.ones(2, 3),
        rotation=torch.ones(2, 4),
    )
    with pytest.raises(GeneratorInvalid, match=r"Cells\.position: NaN in 2 of 2 rows"):
        check_gaussians(scene(cells=cells), 8, "time=0")


def test_quaternions_of_zeros_are_refused() -> None:
    with pytest.raises(GeneratorInvalid) as caught:
        check_gaussians(scene(rotation=_ZERO_QUATERNIONS), 8, "time=0")
    assert caught.value.where == "Gaussians.rotation"
    assert "norm 0 in 8 of 8 visible rows at 'time=0'; expected unit quaternions (w, x, y, z)" in (
        str(caught.value)
    )


@pytest.mark.parametrize(
    "gaussians",
    [
        with_rows("rotation", slice(0, 4), 0.0),  # a few of a trained scene
        replace(with_rows("rotation", slice(0, 8), 0.0), opacity=torch.zeros(8)),  # not drawn
        scene(rotation=1e-4 * torch.ones(8, 4)),  # not normalised
    ],
)
def test_single_and_hidden_quaternions_of_zeros_are_accepted(gaussians: Gaussians) -> None:
    check_gaussians(gaussians, 8, "time=0")


class Wobbling(Drift):
    """NaN at time 0, which is no fault of a kernel."""

    def forward(self, time: Tensor) -> Gaussians:
        drifting = super().forward(time)
        return replace(drifting, position=drifting.position + torch.sin(time) / time)


class Culled(Wobbling):
    def forward(self, time: Tensor) -> Gaussians:
        gaussians = super().forward(time)
        return gaussians.take(*math.keep_rows(torch.ones(50), 40))


class AtTheEnd(Drift):
    """NaN at the last of the test inputs alone."""

    def forward(self, time: Tensor) -> Gaussians:
        drifting = super().forward(time)
        return replace(drifting, position=drifting.position + (1 - time) / (1 - time))


class Shrinking(Drift):
    """The square root is defined in the whole range of time, but not a rounding beyond it."""

    def forward(self, time: Tensor) -> Gaussians:
        drifting = super().forward(time)
        return replace(drifting, position=drifting.position * (1 + torch.sqrt(1 - time)))


@pytest.mark.parametrize(
    ("generator", "words"),
    [
        (Wobbling(), "Gaussians.position: NaN in 50 of 50 rows at 'time=0'"),
        (Culled(), "Gaussians.position: NaN in 40 of 40 rows at 'time=0'"),
        (AtTheEnd(), "Gaussians.position: NaN in 50 of 50 rows at 'time=1'"),
    ],
)
def test_nan_of_eager_torch_is_no_difference_of_the_model(
    tmp_path: Path, generator: Drift, words: str
) -> None:
    with pytest.raises(GeneratorInvalid) as caught:
        export(generator, tmp_path / "m.onnx")
    assert words in str(caught.value)
    assert not (tmp_path / "m.onnx").exists()


def test_values_that_are_finite_within_the_range_are_exported(tmp_path: Path) -> None:
    assert export(Shrinking(), tmp_path / "m.onnx").parity.holds
