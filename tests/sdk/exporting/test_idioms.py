"""How authors write forward: exported with parity, or refused with the line and a change that works."""

from pathlib import Path

import pytest

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import export
from gsgen.sdk.exporting.pipeline import Exported
from sdk.exporting.idioms import EXPORTED, REFUSED, Refusal, Scene
from sdk.exporting.idioms.constants import mean_of_selected_offsets
from sdk.exporting.idioms.inputs_reach import one_true_in_each_row, rows_by_a_moving_mask
from sdk.exporting.idioms.refused import branch_on_an_input, dropout_by_default
from sdk.exporting.idioms.scene import Idiom

STATIC = Settings(level=Level.STATIC)


def export_idiom(function: Idiom, folder: Path) -> Exported:
    """Export an idiom for the target whose rules demand that a graph can be captured."""
    file = folder / "m.onnx"
    return export(Scene(function), file, settings=STATIC, verify="quick", target="webgpu")


def assert_refused(refusal: Refusal, folder: Path) -> None:
    """Assert that an idiom is refused with its line and hint, and exported after the change."""
    with pytest.raises(GsgenError) as caught:
        export_idiom(refusal.function, folder)
    assert "# guilty" in caught.value.where
    assert refusal.hint in caught.value.hint
    assert "please report" not in caught.value.hint
    assert list(folder.iterdir()) == []
    assert export_idiom(refusal.mended, folder).parity.holds


def test_there_are_more_than_a_hundred_idioms() -> None:
    assert len({*EXPORTED, *(refusal.function for refusal in REFUSED)}) > 100


@pytest.mark.parametrize(
    "function",
    [mean_of_selected_offsets, rows_by_a_moving_mask, one_true_in_each_row],
    ids=lambda function: function.__name__,
)
def test_a_mask_is_exported_with_parity(function: Idiom, tmp_path: Path) -> None:
    assert export_idiom(function, tmp_path).parity.holds


@pytest.mark.parametrize(
    "refusal",
    [entry for entry in REFUSED if entry.function in (branch_on_an_input, dropout_by_default)],
    ids=lambda refusal: refusal.function.__name__,
)
def test_an_idiom_of_values_or_training_is_refused_with_its_line(
    refusal: Refusal, tmp_path: Path
) -> None:
    assert_refused(refusal, tmp_path)


# Every third of them before each change, from each module of idioms; all of them at night.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:index_reduce:UserWarning")
@pytest.mark.parametrize(
    "function",
    [
        pytest.param(function, marks=[pytest.mark.nightly] if number % 3 else [])
        for number, function in enumerate(EXPORTED)
    ],
    ids=lambda function: function.__name__,
)
def test_an_idiom_is_exported_with_parity(function: Idiom, tmp_path: Path) -> None:
    assert export_idiom(function, tmp_path).parity.holds


@pytest.mark.slow
@pytest.mark.parametrize("refusal", REFUSED, ids=lambda refusal: refusal.function.__name__)
def test_a_refused_idiom_names_its_line_and_a_change_that_works(
    refusal: Refusal, tmp_path: Path
) -> None:
    assert_refused(refusal, tmp_path)
