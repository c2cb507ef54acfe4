"""How far executions are apart, against an oracle that looks at one number after another."""

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
from gsgen.contract.spec.spherical_harmonics import evaluate
from gsgen.contract.validation import agreement
from gsgen.contract.validation.agreement import comparable_parts, field_errors
from gsgen.contract.validation.report import Tolerance

FIELDS = ("position", "covariance", "opacity", "appearance")
AXES = np.concatenate([np.eye(3), -np.eye(3)])
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
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, degree: int | None, field: str
) -> list[float]:
    """Return the error of each row."""
    errors = []
    for x, y, p, q in zip(*(error.astype(np.float64) for error in (a, b, c, d)), strict=True):
        trace = x[4] + x[7] + x[9]
        sh = p.reshape(-1, 3) - q.reshape(-1, 3)
        visited = (
            max(abs(v) for v in (p - q)[:3])
            if degree is None
            else max(
                abs(evaluate(sh[None], axis[None]) - 0.5).max()  # 0.5 + Σ Y c, unclamped here
                for axis in AXES
            )
        )
        error = {
            "opacity": abs(x[3] - y[3]),
            "position": max(abs(x[:3] - y[:3])) / (trace / 3) ** 0.5,
            "covariance": max(abs(x[4:] - y[4:])) / trace,
            "appearance": visited,
        }
        drawn = max(x[3], y[3]) >= 1 / 255 or field == "opacity"
        errors.append(error[field] if drawn else 0.0)
    return errors


@pytest.mark.parametrize("block", [7, 1 << 16])
@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("degree", [0, 1, 3, None])
def test_the_worst_row_is_the_oracle_s(
    field: str, degree: int | None, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows are compared in blocks."""
    monkeypatch.setattr(agreement, "_COMPARED_ROWS", block)
    rng = np.random.default_rng([3, degree or 9])
    a, c = encode(cloud(30, degree), np.float32)
    b, d = a.copy(), c.copy()
    part = {"position": np.s_[:, :3], "opacity": np.s_[:, 3], "covariance": np.s_[:, 4:]}
    changed, columns = (d, np.s_[:]) if field == "appearance" else (b, part[field])
    changed[columns] += rng.uniform(0.01, 0.1, changed[columns].shape)
    a[4, 3] = b[4, 3] = 0 if field != "opacity" else a[4, 3]  # not drawn, not compared
    errors = list(field_errors(emission(a, c, degree), emission(b, d, degree), tolerances(1e-3)))
    assert [error.tolerance.field for error in errors] == [field]
    expected = oracle(a, b, c, d, degree, field)
    assert errors[0].error == pytest.approx(max(expected), rel=1e-6)
    assert errors[0].row == int(np.argmax(expected))
    assert not list(
        field_errors(emission(a, c, degree), emission(b, d, degree), tolerances(max(expected)))
    )


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_one_rounding_of_storage_is_no_difference(dtype: type) -> None:
    a, c = encode(cloud(500, 3), dtype)
    b, d = (np.nextafter(error, dtype(np.inf)) for error in (a, c))
    assert not list(field_errors(emission(a, c, 3), emission(b, d, 3), tolerances(0.0)))


@pytest.mark.filterwarnings("ignore:invalid value")  # the engine judges so
@pytest.mark.parametrize("degree", [0, 1, None])
@pytest.mark.parametrize("field", FIELDS)
def test_what_is_not_finite_counts_where_it_is_on_one_side(field: str, degree: int | None) -> None:
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
        assert [(error.tolerance.field, error.row) for error in errors] == [(field, 3)]


def test_other_sizes_are_not_compared() -> None:
    a, c = encode(cloud(5, 1), np.float32)
    assert comparable_parts(emission(a, c, 1), emission(a[:4], c[:4], 1)) == (False, False, False)
    assert comparable_parts(emission(a, c[:, :7], 1), emission(a, c[:, :7], 1)) == (
        True,
        False,
        False,
    )
    assert comparable_parts(emission(a, c, 1), emission(a, c, 1)) == (True, True, False)
    assert not list(field_errors(emission(a, c, 1), emission(a[:4], c[:4], 1), tolerances(0)))
    none = emission(a[:0], c[:0], 1)
    assert not list(field_errors(none, none, tolerances(0)))


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
    ("cell", "column", "by", "field"),
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
    cell: int, column: int, by: float, field: str
) -> None:
    known, changed = four_cells(), four_cells()
    changed[cell, column] += by
    errors = list(field_errors(in_cells(known), in_cells(changed), tolerances(1e-4)))
    assert [(error.tolerance.field, error.row, error.of_cells) for error in errors] == (
        [(field, cell, True)] if field else []
    )
    trace = known[cell, [4, 7, 9]].sum()
    unit = {"position": (trace / 3) ** 0.5, "covariance": trace}.get(field, 1.0)
    if errors and np.isfinite(by):
        assert errors[0].error == pytest.approx(by / unit, rel=1e-3)


def test_cells_of_another_number_cannot_be_compared() -> None:
    assert comparable_parts(in_cells(four_cells()), in_cells(four_cells())) == (True, True, True)
    for cells in (four_cells()[:2], None):
        fewer = in_cells(four_cells())
        changed = replace(fewer, count=12, declared=None, cells=cells)
        assert comparable_parts(fewer, changed) == (True, True, False)
        assert not list(field_errors(fewer, changed, tolerances(0.0)))
