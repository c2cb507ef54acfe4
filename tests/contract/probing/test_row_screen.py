"""The screen of rows lets no fault pass that a rule of single runs reports."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing import row_screen
from gsgen.contract.probing.outputs import ModelOutputs, chunks
from gsgen.contract.probing.row_screen import look_faulty
from gsgen.contract.rules.values import covariance, rows

ROW_RULES = (
    rows.opacity_range,
    rows.float16_saturation,
    rows.padding_inert,
    covariance.variance_not_negative,
    covariance.covariance_psd,
)
# Column → values that are wrong there, or right.
CHANGES = {
    3: (-0.5, 1.5, 0.0, 1.0, 1 / 300),
    4: (-1.0, 0.0, 1e-8),
    5: (3.0, -3.0, 0.01),
    7: (-1e-3, 1e-6, 7e4),
    9: (0.0, 2.0),
}


def valid_rows(count: int, rng: np.random.Generator) -> np.ndarray:
    table = np.zeros((count, 10))
    table[:, :3], table[:, 3] = rng.normal(size=(count, 3)), rng.uniform(0.1, 1, count)
    root = rng.normal(size=(count, 3, 3))
    full = root @ root.transpose(0, 2, 1)
    table[:, 4:] = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return table


def outputs_of(table: np.ndarray, count: int) -> ModelOutputs:
    subject = SimpleNamespace(declared_gaussians=SimpleNamespace(name="rows"))
    return ModelOutputs(
        probe="", zeros=False, outputs={}, gaussians=table, appearance=None, count=count,
        declared=None, subject=cast(InspectedModel, subject),
    )  # fmt: skip


def is_reported(table: np.ndarray, count: int) -> bool:
    """Return whether a rule of rows reports a row: the oracle."""
    with np.errstate(all="ignore"):
        return any(
            violation.invalid_rows is not None and violation.invalid_rows.any()
            for rule in ROW_RULES
            for chunk in chunks(outputs_of(table, count))
            for violation in rule.check(chunk)
        )


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_what_a_rule_reports_looks_faulty(dtype, monkeypatch):
    rng = np.random.default_rng(4)
    monkeypatch.setattr(row_screen, "_BLOCK_ROWS", 5)
    reported = 0
    for _ in range(400):
        count = int(rng.integers(1, 14))
        table = valid_rows(13, rng)
        table[count:] = 0
        column = int(rng.choice([*CHANGES]))
        table[rng.integers(13), column] = rng.choice(CHANGES[column])
        with np.errstate(over="ignore"):
            table = table.astype(dtype)
        is_wrong = np.isfinite(table).all() and is_reported(table, count)
        reported += is_wrong
        assert not is_wrong or look_faulty(table, np.int32([count]), None, 0)
    assert reported > 100


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_right_rows_do_not_look_faulty(dtype):
    rng = np.random.default_rng(5)
    table = valid_rows(1000, rng)
    table[:500, 4:] *= [1, 1, 0, 1, 0, 0]  # disks
    table[900:] = 0
    assert not look_faulty(table.astype(dtype), np.int32([900]), None, 0)


@pytest.mark.parametrize("count", [-1, 4, 2**31 - 1])
def test_a_count_beyond_the_capacity_looks_faulty(count):
    table = valid_rows(3, np.random.default_rng(6)).astype(np.float32)
    assert look_faulty(table, np.int32([count]), None, 0)
    assert not look_faulty(table, np.int32([3]), None, 0)


def test_cells_out_of_range_or_empty_and_visible_look_faulty():
    table = valid_rows(4, np.random.default_rng(7)).astype(np.float32)
    table[2:] = 0
    cells = valid_rows(2, np.random.default_rng(8)).astype(np.float32)
    assert look_faulty(table, np.int32([2]), cells, 2)  # the second cell is empty
    cells[1] = 0
    assert not look_faulty(table, np.int32([2]), cells, 2)
    cells[0, 3] = 1.5
    assert look_faulty(table, np.int32([2]), cells, 2)
