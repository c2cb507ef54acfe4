"""How far executions are apart, against an oracle that looks at one number after another."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.clouds import cloud
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.spec.layout import encode
from gsgen.contract.spec.manifest import AppearanceOutput
from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.contract.validation import agreement
from gsgen.contract.validation.agreement import comparable_parts, field_errors, tolerance_of
from gsgen.contract.validation.report import Tolerance

FIELDS = ("position", "covariance", "opacity", "appearance")
NAMES = cast(InspectedModel, SimpleNamespace())


def emission(rows: np.ndarray, color: np.ndarray, degree: int | None) -> ModelOutputs:
    declared = AppearanceOutput("c", "rgb" if degree is None else "sh", degree)
    return ModelOutputs(
        probe="p",
        zeros=False,
        outputs={},
        gaussians=rows,
        appearance=color,
        count=len(rows),
        declared=declared,
        subject=NAMES,
    )


def tolerances(value: float) -> list[Tolerance]:
    return [Tolerance(field, value, "", "default") for field in FIELDS]


def oracle(
    rows: np.ndarray, others: np.ndarray, color: np.ndarray, peers: np.ndarray, degree: int | None
) -> dict[str, list[tuple[float, float]]]:
    """Error and allowed error of each row by docs/spec/agreement.md, number by number.

    The tolerances are zero, so that what is allowed is the rounding of two executions.
    """
    half = rows.dtype == np.float16
    r = 2 * (2**-11 + 2**-20) if half else 2 * (2**-24 + 2**-20)
    s = 2**-23 if half else 2**-148
    pairs: dict[str, list[tuple[float, float]]] = {field: [] for field in FIELDS}
    values = (array.astype(np.float64).tolist() for array in (rows, others, color, peers))
    for a, b, c, d in zip(*values, strict=True):
        trace = max(a[4] + a[7] + a[9], 1e-30)
        sigma = math.sqrt(trace / 3)
        drawn = not (a[3] < 1 / 255 and b[3] < 1 / 255)
        position = max(abs(x - y) for x, y in zip(a[:3], b[:3], strict=True)) / sigma
        covariance = max(abs(x - y) for x, y in zip(a[4:], b[4:], strict=True)) / trace
        if degree is None:
            appearance = max(abs(x - y) for x, y in zip(c[:3], d[:3], strict=True))
            magnitude = max(abs(x) for x in c[:3])
        else:
            appearance, magnitude = color_error(c, d)
        reach = max(abs(x) for x in a[:3])
        pairs["position"].append((position * drawn, (r * reach + 2 * s) / sigma))
        pairs["covariance"].append((covariance * drawn, r + 2 * s / trace))
        pairs["opacity"].append((abs(a[3] - b[3]), r))
        pairs["appearance"].append((appearance * drawn, r * magnitude))
    return pairs


def directions() -> list[tuple[float, float, float]]:
    """The 64 directions of the page."""
    result = []
    for i in range(64):
        z, angle = 1 - (2 * i + 1) / 64, math.pi * (1 + math.sqrt(5)) * (i + 0.5)
        ring = math.sqrt(1 - z * z)
        result.append((ring * math.cos(angle), ring * math.sin(angle), z))
    return result


WEIGHTS = [basis(np.array(direction)).tolist() for direction in directions()]


def color_error(c: list[float], d: list[float]) -> tuple[float, float]:
    """The largest difference of colours from 64 directions, and the largest sum of sizes."""
    difference = magnitude = 0.0
    for weights in WEIGHTS:
        for channel in range(3):
            terms = list(zip(weights, c[channel::3], d[channel::3], strict=False))
            difference = max(difference, abs(sum(w * (p - q) for w, p, q in terms)))
            magnitude = max(magnitude, sum(abs(w) * abs(p) for w, p, _ in terms))
    return difference, magnitude


@pytest.mark.parametrize("block", [7, 1 << 16])
@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float16])
@pytest.mark.parametrize("degree", [0, 1, 3, None])
def test_the_worst_row_is_the_oracle_s(
    field: str, degree: int | None, dtype: type, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows are compared in blocks; one field differs by a few roundings or by much more."""
    monkeypatch.setattr(agreement, "ROWS_PER_BLOCK", block)
    rng = np.random.default_rng([3, degree or 9])
    a, c = encode(cloud(30, degree), dtype)
    b, d = a.copy(), c.copy()
    part = {"position": np.s_[:, :3], "opacity": np.s_[:, 3], "covariance": np.s_[:, 4:]}
    changed, columns = (d, np.s_[:]) if field == "appearance" else (b, part[field])
    changed[columns] += rng.uniform(0.01, 0.1, changed[columns].shape).astype(dtype)
    a[4, 3] = b[4, 3] = 0 if field != "opacity" else a[4, 3]  # not drawn, not compared
    first, second = emission(a, c, degree), emission(b, d, degree)
    pairs = oracle(a, b, c, d, degree)[field]
    excess = [error / allowed for error, allowed in pairs]
    row = int(np.argmax(excess))
    (error,) = field_errors(first, second, tolerances(0.0))
    assert (error.field, error.row) == (field, row)
    assert error.error == pytest.approx(pairs[row][0], rel=1e-9)
    assert error.excess == pytest.approx(excess[row], rel=1e-9)
    # A tolerance a little above or below what rounding leaves of the errors decides.
    remaining = max(error - allowed for error, allowed in pairs)
    assert not list(field_errors(first, second, tolerances(remaining * (1 + 1e-9))))
    assert list(field_errors(first, second, tolerances(remaining * (1 - 1e-9))))


def test_every_coefficient_of_a_colour_is_seen() -> None:
    """From the six axes, x y, y z, x z, x y z and z (x² - y²) would be zero."""
    a, c = encode(cloud(16, 3), np.float32)
    d = c.copy()
    d[np.arange(16), 3 * np.arange(16)] += 0.01
    (error,) = field_errors(emission(a, c, 3), emission(a, d, 3), tolerances(0.002))
    assert error.field == "appearance"
    for row in range(16):
        entry = emission(a[row : row + 1], c[row : row + 1], 3)
        other = emission(a[row : row + 1], d[row : row + 1], 3)
        assert list(field_errors(entry, other, tolerances(0.002))), row


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_one_rounding_of_storage_is_no_difference(dtype: type) -> None:
    a, c = encode(cloud(500, 3), dtype)
    b, d = (np.nextafter(error, dtype(np.inf)) for error in (a, c))
    assert not list(field_errors(emission(a, c, 3), emission(b, d, 3), tolerances(0.0)))


@pytest.mark.filterwarnings("ignore:invalid value")  # the engine judges so
@pytest.mark.parametrize("degree", [0, 1, None])
@pytest.mark.parametrize("field", FIELDS)
def test_nonfinite_value_in_one_run_is_a_difference(field: str, degree: int | None) -> None:
    a, c = encode(cloud(9, degree), np.float32)
    a[1, 0], a[2, 4], c[5, 0], c[6, 1] = np.nan, np.inf, np.inf, np.nan
    b, d = a.copy(), c.copy()
    assert not list(field_errors(emission(a, c, degree), emission(b, d, degree), tolerances(0)))
    changed, column = {
        "position": (b, 1),
        "opacity": (b, 3),
        "covariance": (b, 5),
        "appearance": (d, 2),
    }[field]
    for value in (np.inf, np.nan, changed[3, column] + 2):
        changed[3, column] = value
        errors = list(field_errors(emission(a, c, degree), emission(b, d, degree), tolerances(0.5)))
        assert [(error.field, error.row) for error in errors] == [(field, 3)]


def test_a_row_of_nan_opacity_in_both_runs_is_compared() -> None:
    a, c = encode(cloud(3, 1), np.float32)
    a[1, 3] = np.nan
    b = a.copy()
    b[1, 0] += 1
    (error,) = field_errors(emission(a, c, 1), emission(b, c, 1), tolerances(0.01))
    assert (error.field, error.row) == ("position", 1)


def parts(first: ModelOutputs, second: ModelOutputs) -> tuple[bool, ...]:
    """Whether rows, colours and cells can be compared."""
    return tuple(pair is not None for pair in comparable_parts(first, second))


def test_other_sizes_are_not_compared() -> None:
    a, c = encode(cloud(5, 1), np.float32)
    assert parts(emission(a, c, 1), emission(a[:4], c[:4], 1)) == (False, False, False)
    assert parts(emission(a, c[:, :7], 1), emission(a, c[:, :7], 1)) == (True, False, False)
    assert parts(emission(a, c, 1), emission(a, c, 1)) == (True, True, False)
    assert not list(field_errors(emission(a, c, 1), emission(a[:4], c[:4], 1), tolerances(0)))
    none = emission(a[:0], c[:0], 1)
    assert not list(field_errors(none, none, tolerances(0)))


def test_rows_behind_the_count_are_not_compared() -> None:
    a, c = encode(cloud(5, 1), np.float32)
    b = a.copy()
    b[3:, 3] = 0.5
    first, second = (replace(emission(rows, c, 1), count=3) for rows in (a, b))
    assert not list(field_errors(first, second, tolerances(0)))
    (error,) = field_errors(first, replace(second, count=4), tolerances(0))
    assert (error.field, error.row) == ("opacity", 3)


# ---- Cells -------------------------------------------------------------------------------------


def in_cells(cells: np.ndarray, count: int = 3) -> ModelOutputs:
    """Twelve rows, three to a cell; those of the last cell are transparent."""
    rows, color = encode(cloud(4 * count, None))
    rows[-count:, 3] = 0
    declared = AppearanceOutput("c", "rgb", None)
    return ModelOutputs(
        probe="p",
        zeros=False,
        outputs={},
        gaussians=rows,
        appearance=color,
        count=len(rows),
        declared=declared,
        subject=NAMES,
        cells=cells,
    )


def four_cells() -> np.ndarray:
    rows = encode(cloud(4, None, seed=3))[0]
    rows[2, 3] = 0
    return rows


@pytest.mark.parametrize(
    ("cell", "column", "factor", "field"),
    [
        (0, 1, 0.01, "position"),
        (1, 8, 0.01, "covariance"),
        (1, 3, 0.01, "opacity"),
        (2, 3, 0.01, "opacity"),  # not seen in one of both
        (0, 1, 1e-8, ""),
        (2, 1, 0.01, ""),  # not seen
        (3, 1, 0.01, ""),  # nothing to be seen in it
        (3, 3, 0.01, "opacity"),
        (0, 1, np.nan, "position"),
    ],
)
def test_cells_are_compared_in_the_units_of_rows(
    cell: int, column: int, factor: float, field: str
) -> None:
    known, changed = four_cells(), four_cells()
    changed[cell, column] += factor
    errors = list(field_errors(in_cells(known), in_cells(changed), tolerances(1e-4)))
    expected = f"cell {'visibility' if field == 'opacity' else field}"
    assert [(error.field, error.row) for error in errors] == ([(expected, cell)] if field else [])
    assert all(tolerance_of(error, tolerances(0)).field == field for error in errors)
    trace = known[cell, [4, 7, 9]].sum()
    unit = {"position": (trace / 3) ** 0.5, "covariance": trace}.get(field, 1.0)
    if errors and np.isfinite(factor):
        assert errors[0].error == pytest.approx(factor / unit, rel=1e-3)


def test_cells_of_another_number_cannot_be_compared() -> None:
    assert parts(in_cells(four_cells()), in_cells(four_cells())) == (True, True, True)
    for cells in (four_cells()[:2], None):
        fewer_cells = in_cells(four_cells())
        changed = replace(fewer_cells, count=12, declared=None, cells=cells)
        assert parts(fewer_cells, changed) == (True, True, False)
        assert not list(field_errors(fewer_cells, changed, tolerances(0.0)))
