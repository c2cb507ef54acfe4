"""Value rules against oracles that look at one row at a time, in float64, one number after another."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs, Rows
from gsgen.contract.rules.values import appearance, covariance
from gsgen.contract.rules.values import rows as values
from gsgen.contract.spec.manifest import AppearanceOutput, GaussiansOutput
from gsgen.contract.validation.rule import Rule
from gsgen.contract.validator import validate

DTYPES = {16: np.float16, 32: np.float32}
SLACK = {np.float16: 2.0**-10, np.float32: 1e-5}
FLOOR = {np.float16: 3 * 2.0**-25, np.float32: 0.0}
NAMES = SimpleNamespace(declared_gaussians=GaussiansOutput("gaussians", 1), candidate=None)
RGB = AppearanceOutput("color", "rgb")

Row = list[float]


def rows_of(packed: np.ndarray, color: np.ndarray | None = None, count: int = 1) -> Rows:
    subject = cast(InspectedModel, NAMES)
    emission = ModelOutputs(
        probe="a probe",
        zeros=False,
        outputs={},
        gaussians=packed,
        appearance=color,
        count=count,
        declared=RGB,
        subject=subject,
    )
    return Rows(emission, 0, packed, color)


def bad_rows(rule: Rule, rows: Rows) -> set[int]:
    """Return which rows break ``rule``, at any place."""
    with np.errstate(all="ignore"):  # as the engine does
        breaches = [breach for breach in rule.check(rows) if breach.invalid_rows is not None]
    return {int(row) for breach in breaches for row in np.flatnonzero(breach.invalid_rows)}


def finite(row: Row) -> bool:
    return all(math.isfinite(value) for value in row)


def drawn(row: Row, color: Row, live: bool) -> bool:
    return live and finite(row + color) and row[3] >= float(np.float32(1 / 255))


# Says of a packed row, its colour, whether it lies before the count, and whether it is float16,
# if the rule must complain.
Oracle = Callable[[Row, Row, bool, bool], bool]

ORACLES: dict[str, tuple[Rule, Oracle]] = {
    "GV001": (values.rows_finite, lambda row, color, live, half: live and not finite(row + color)),
    "GV002": (
        values.padding_finite,
        lambda row, color, live, half: not live and not finite(row + color),
    ),
    "GV003": (
        values.opacity_range,
        lambda row, color, live, half: (
            live and finite(row + color) and not -1e-3 <= row[3] <= 1 + 1e-3
        ),
    ),
    "GV004": (
        values.mostly_visible,
        lambda row, color, live, half: (
            live and finite(row + color) and row[3] < float(np.float32(1 / 255))
        ),
    ),
    "GV005": (
        covariance.variance_not_negative,
        lambda row, color, live, half: drawn(row, color, live) and min(row[4], row[7], row[9]) < 0,
    ),
    "GV007": (
        covariance.covariance_not_zero,
        lambda row, color, live, half: drawn(row, color, live) and not any(row[4:]),
    ),
    "GV010": (
        values.float16_saturation,
        lambda row, color, live, half: (
            half
            and live
            and finite(row + color)
            and max(abs(value) for value in row + color) >= 65504
        ),
    ),
    "GV012": (
        appearance.rgb_range,
        lambda row, color, live, half: (
            drawn(row, color, live) and not all(-0.01 <= c <= 1.01 for c in color[:3])
        ),
    ),
    "GV018": (
        values.padding_inert,
        lambda row, color, live, half: not live and math.isfinite(row[3]) and row[3] != 0,
    ),
}

EDGES = (0.0, -0.0, 1.0, 0.5, -0.5, 0.0039, 0.004, -2e-3, 1.002, 2.0, 65504.0, 1e-6)
NONFINITE_VALUES = (math.nan, math.inf, -math.inf)


@st.composite
def emissions(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, int]:
    """Draw packed rows, RGB colours and a count, with edges and wild values here and there."""
    dtype = DTYPES[draw(st.sampled_from((16, 32)))]
    number = draw(st.integers(0, 6))
    edge_values = st.sampled_from(EDGES)
    cells = draw(st.lists(edge_values, min_size=14 * number, max_size=14 * number))
    table = np.asarray(cells).reshape(number, 14)
    if number:
        spots = st.tuples(st.integers(0, number - 1), st.integers(0, 13))
        for element_index, value in draw(
            st.lists(st.tuples(spots, st.sampled_from(NONFINITE_VALUES)), max_size=2)
        ):
            table[element_index] = value
        for row in draw(st.sets(st.integers(0, number - 1), max_size=2)):
            table[row, 4:10] = 0
    table = table.astype(dtype)
    return table[:, :10].copy(), table[:, 10:].copy(), draw(st.integers(0, number))


@pytest.mark.parametrize("id", ORACLES)
@given(emission=emissions())
@settings(max_examples=150)
def test_rule_reports_the_rows_that_its_oracle_rejects(
    id: str, emission: tuple[np.ndarray, np.ndarray, int]
):
    packed, color, count = emission
    rule, rejects = ORACLES[id]
    half = packed.dtype == np.float16
    expected = {
        index
        for index, (row, shade) in enumerate(
            zip(packed.astype(float).tolist(), color.astype(float).tolist(), strict=True)
        )
        if rejects(row, shade, index < count, half)
    }
    assert rule.id == id
    assert bad_rows(rule, rows_of(packed, color, count)) == expected


def symmetric(upper: np.ndarray) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = upper.astype(np.float64).T
    full = np.asarray([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.moveaxis(full, -1, 0)


def packed_with(upper: np.ndarray) -> np.ndarray:
    rows = np.zeros((len(upper), 10), upper.dtype)
    rows[:, 3] = 1
    rows[:, 4:] = upper
    return rows


def check_psd(upper: np.ndarray) -> None:
    """Compare GV006 with numpy.linalg.eigvalsh, a hair's breadth around the tolerance left out."""
    tolerance = SLACK[upper.dtype.type]
    matrices = symmetric(upper)
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    trace = np.abs(diagonal).sum(axis=1)
    min_scale = FLOOR[upper.dtype.type]
    margin = np.linalg.eigvalsh(matrices)[:, 0] + tolerance * trace + min_scale
    checked = (diagonal >= 0).all(axis=1)  # a negative variance is GV005's
    expected = set(np.flatnonzero(checked & (margin < 0)).tolist())
    is_close = np.abs(margin) <= 1e-7 * np.abs(matrices).max(axis=(1, 2))
    invalid_rows = bad_rows(
        covariance.covariance_psd, rows_of(packed_with(upper), None, len(upper))
    )
    assert invalid_rows ^ expected <= set(np.flatnonzero(is_close).tolist())


def uppers(matrices: np.ndarray, dtype: Any) -> np.ndarray:
    with np.errstate(over="ignore"):
        upper = matrices[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]].astype(dtype)
    return upper[np.isfinite(upper).all(axis=1)]


@pytest.mark.parametrize("dtype", DTYPES.values(), ids=lambda dtype: dtype.__name__)
@given(seed=st.integers(0, 2**32 - 1), scale=st.integers(-12, 12))
@settings(max_examples=150)
def test_symmetric_matrices_are_judged_as_by_eigvalsh(dtype: Any, seed: int, scale: int):
    matrices = np.random.default_rng(seed).normal(size=(64, 3, 3))
    symmetric_matrices = matrices + matrices.transpose(0, 2, 1) + 3 * np.eye(3)
    check_psd(uppers(10.0**scale * symmetric_matrices, dtype))


@pytest.mark.parametrize("dtype", DTYPES.values(), ids=lambda dtype: dtype.__name__)
@given(
    seed=st.integers(0, 2**32 - 1),
    scale=st.integers(-8, 6),
    thickness=st.floats(0, 1),
    excess_factor=st.floats(0.5, 1.5),
)
@settings(max_examples=200)
def test_documented_tolerance_is_the_limit(
    dtype: Any, seed: int, scale: int, thickness: float, excess_factor: float
):
    rng = np.random.default_rng(seed)
    turned = np.linalg.qr(rng.normal(size=(64, 3, 3)))[0]
    lowest = (
        -excess_factor * SLACK[dtype] * (1 + thickness)
    )  # from half to one and a half times allowed
    sigma = turned * np.asarray([1.0, thickness, lowest]) @ turned.transpose(0, 2, 1)
    check_psd(uppers(10.0**scale * sigma, dtype))


@pytest.mark.parametrize("dtype", DTYPES.values(), ids=lambda dtype: dtype.__name__)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=150)
def test_entries_of_very_different_size_are_judged_as_by_eigvalsh(dtype: Any, seed: int):
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-5, 1, (64, 6))
    entries = sizes * np.where(rng.random((64, 6)) < 0.5, -1, 1)
    entries[:, [0, 3, 5]] = sizes[:, [0, 3, 5]]
    check_psd(entries.astype(dtype))


@pytest.mark.parametrize("dtype", DTYPES.values(), ids=lambda dtype: dtype.__name__)
@given(seed=st.integers(0, 2**32 - 1), axes=st.tuples(*[st.floats(-4, 0)] * 3))
@settings(max_examples=200)
def test_a_proper_covariance_survives_rounding(
    dtype: Any, seed: int, axes: tuple[float, float, float]
):
    rng = np.random.default_rng(seed)
    turned = np.linalg.qr(rng.normal(size=(64, 3, 3)))[0]
    spread = turned * 10.0 ** np.asarray(axes)
    upper = uppers(spread @ spread.transpose(0, 2, 1), dtype)
    rows = rows_of(packed_with(upper), None, len(upper))
    assert not bad_rows(covariance.covariance_psd, rows)
    assert not bad_rows(covariance.variance_not_negative, rows)


def test_rows_beyond_the_first_chunk_are_counted_from_the_start():
    packed = packed_with(np.ones((4, 6), np.float32))
    emission = ModelOutputs(
        probe="a probe",
        zeros=False,
        outputs={},
        gaussians=packed,
        appearance=None,
        count=3,
        declared=RGB,
        subject=cast(InspectedModel, NAMES),
    )
    assert Rows(emission, 2, packed[2:], None).counted.tolist() == [True, False]
    assert Rows(emission, 4, packed[:0], None).live_rows == 0


@pytest.mark.parametrize(("value", "valid"), [(-0.5, True), (1.5, True), (-0.6, False), (2, False)])
def test_rgb_lies_in_the_declared_range(value: float, valid: bool, tmp_path: Path) -> None:
    rgb = AppearanceOutput("color", "rgb", range=(-0.5, 1.5))
    scene = still(degree=None).with_outputs(appearance=rgb)
    scene.with_weight_values("colors", np.s_[0], value).write(tmp_path / "m.onnx")
    findings = validate(tmp_path / "m.onnx").findings
    messages = [finding.message for finding in findings if finding.rule == "GV012"]
    assert messages == [] if valid else "-0.5 <= rgb <= 1.5" in messages[0]


@pytest.mark.parametrize(("is_inferred", "certainty"), [(True, "possible"), (False, "confirmed")])
def test_three_channels_without_a_manifest_may_be_sh(
    is_inferred: bool, certainty: str, tmp_path: Path
):
    scene = still(degree=0).with_weight_values("colors", np.s_[0], -0.4)
    unlabelled = replace(scene, manifest=None if is_inferred else scene.manifest)
    rgb = AppearanceOutput("color", "rgb")
    model = unlabelled if is_inferred else unlabelled.with_outputs(appearance=rgb)
    model.write(tmp_path / "m.onnx")
    report = validate(tmp_path / "m.onnx")
    (is_invalid,) = (finding for finding in report.findings if finding.rule == "GV012")
    assert is_invalid.certainty == certainty
