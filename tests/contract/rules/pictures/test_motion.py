"""Rules of motion compare rows by index, which says nothing where the number of rows changes."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.arrays import f32, i64
from gsgen.conformance.fixtures.builders.moving import SHIFT_NODE, drifting_model
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import Input
from gsgen.contract.validator import validate

_ROWS = 200
# Rows are selected as gsgen.sdk.math.keep_rows does: those to keep, in their order, then the others.
_SELECTION = (
    "kept = Greater (rank, edge) mask = Cast <to = 1> (kept) score = Mul (mask, order) "
    "best, rows = TopK (score, size) column = Unsqueeze (mask, one) "
    "visible = Mul (opacity, column) joined = Concat <axis = 1> (moved, visible, spread) "
    "gaussians = Gather (joined, rows) sum = ReduceSum <keepdims = 1> (mask) "
)


def culled(edge: str, shift: str = SHIFT_NODE) -> ModelSpec:
    """Return a model that drops the rows whose rank, from 0 to 1, is not above ``edge``."""
    selected = (
        drifting_model(_ROWS)
        .replace_text(SHIFT_NODE, f"{shift} edge = {edge}")
        .replace_text("gaussians = Concat <axis = 1> (moved, opacity, spread)", _SELECTION)
        .replace_text("color = Identity (colors)", "color = Gather (colors, rows)")
        .replace_text("num_points = Identity (live)", "num_points = Cast <to = 6> (sum)")
    )
    rank = np.random.default_rng(5).permutation(_ROWS).astype(np.float32) / _ROWS
    order = np.arange(_ROWS, 0, -1).astype(np.float32)
    weights = {"rank": rank, "order": order, "half": f32(0.5), "degrees": f32(360.0)}
    return selected.with_weights(**weights, size=i64(_ROWS), one=i64(1))


def motion_findings(model: ModelSpec, folder: Path) -> set[str]:
    """Validate a model, and return the rules of motion that it breaks."""
    path = folder / "m.onnx"
    model.write(path)
    report = validate(path)
    assert report.outcome("GB005").status in ("pass", "fail")
    return {finding.rule for finding in report.findings} & {"GB005", "GB034"}


def test_dropped_rows_are_no_motion_of_the_rows_behind_them(tmp_path: Path) -> None:
    assert motion_findings(culled("Mul (time, half)"), tmp_path) == set()


def test_rows_dropped_between_two_refreshes_are_no_motion_either(tmp_path: Path) -> None:
    time = Input(name="time", role="time", range=(0.0, 1.0), default=0.0, frames=20, fps=20.0)
    model = culled("Mul (time, half)").with_manifest(inputs=(time,))
    assert motion_findings(model, tmp_path) == set()


@pytest.mark.parametrize("edge", ["Mul (half, half)", "Sub (half, half)"])
def test_erratic_motion_is_found_if_the_same_rows_are_dropped_in_each_frame(
    edge: str, tmp_path: Path
) -> None:
    wave = "angle = Mul (time, degrees) wave = Sin (angle) shift = Mul (speed, wave)"
    assert "GB034" in motion_findings(culled(edge, wave), tmp_path)
