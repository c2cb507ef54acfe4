"""Rules of cells against oracles that look at one cell or row at a time, in plain Python."""

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.rules.values import cells as rules
from gsgen.contract.spec.manifest import CellsOutput, GaussiansOutput
from gsgen.contract.validation.rule import Rule

FEW, PER_CELL = 40, 3
NAMES = SimpleNamespace(
    declared_gaussians=GaussiansOutput("gaussians", FEW * PER_CELL),
    declared_cells=CellsOutput("cells", PER_CELL),
    declared_count=None,
)
SPECIAL_VALUES = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -0.5, 1.5, 65504.0, 1e-6)
DTYPES = pytest.mark.parametrize("dtype", [np.float32, np.float16])
SEEDS = pytest.mark.parametrize("seed", range(6))

Row = list[float]


def emission(seed: int, dtype: type) -> ModelOutputs:
    """Cells and rows of which some are odd, hidden, indefinite, far away or behind the count."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(FEW, 3, 3)) * rng.uniform(0.05, 0.5, (FEW, 1, 3))
    full = axes @ axes.transpose(0, 2, 1)
    cell_rows = np.zeros((FEW, 10))
    cell_rows[:, :3] = rng.uniform(-2, 2, (FEW, 3))
    cell_rows[:, 3] = rng.uniform(0, 1, FEW) * (rng.random(FEW) < 0.8)
    cell_rows[:, 4:] = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    cell_rows[rng.random(FEW) < 0.1, 5] *= 9
    rows = np.zeros((FEW * PER_CELL, 10))
    size = np.sqrt(full.trace(axis1=1, axis2=2))[:, None, None]
    near = cell_rows[:, None, :3] + size * rng.normal(0, 0.9, (FEW, PER_CELL, 3))
    rows[:, :3], rows[:, 3] = near.reshape(-1, 3), rng.uniform(-0.2, 1, FEW * PER_CELL)
    for table, share in ((cell_rows, 0.2), (rows, 0.1)):
        for row in np.flatnonzero(rng.random(len(table)) < share):
            table[row, rng.integers(0, 10)] = rng.choice(SPECIAL_VALUES)
    count = int(rng.integers(0, FEW * PER_CELL + 1))
    with np.errstate(over="ignore"):
        packed, cells = rows.astype(dtype), cell_rows.astype(dtype)
    subject = cast(InspectedModel, NAMES)
    return ModelOutputs(
        probe="p",
        zeros=False,
        outputs={},
        gaussians=packed,
        appearance=None,
        count=count,
        declared=None,
        subject=subject,
        cells=cells,
    )


def violating_rows(rule: Rule, outputs: ModelOutputs) -> set[int]:
    with np.errstate(all="ignore"):  # as the engine does
        (breach,) = rule.check(outputs)
    assert breach.invalid_rows is not None
    return {int(row) for row in np.flatnonzero(breach.invalid_rows)}


def finite(row: Row, half: bool) -> bool:
    return all(math.isfinite(x) and not (half and abs(x) >= 65504) for x in row)


def smallest(row: Row) -> float:
    xx, xy, xz, yy, yz, zz = row[4:]
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], np.float64)
    return float(np.linalg.eigvalsh(matrix)[0])


@SEEDS
@DTYPES
def test_cells_are_judged_one_by_one(seed: int, dtype: type) -> None:
    outputs = emission(seed, dtype)
    assert outputs.cells is not None
    half = dtype is np.float16
    tolerance, min_scale = (2.0**-10, 3 * 2.0**-25) if half else (1e-5, 0.0)
    expected: dict[str, set[int]] = {name: set() for name in ("26", "27", "28", "30")}
    for cell, row in enumerate(outputs.cells.astype(np.float64).tolist()):
        if not finite(row, half):
            expected["26"].add(cell)
        elif not -1e-3 <= row[3] <= 1.001:
            expected["27"].add(cell)
        if finite(row, half) and row[3] > 0:
            size = abs(row[4]) + abs(row[7]) + abs(row[9])
            if smallest(row) < -tolerance * size - min_scale:
                expected["28"].add(cell)
        if cell * PER_CELL >= outputs.count and math.isfinite(row[3]) and row[3] != 0:
            expected["30"].add(cell)
    assert violating_rows(rules.cells_finite, outputs) == expected["26"]
    assert violating_rows(rules.visibility_range, outputs) == expected["27"]
    assert violating_rows(rules.cell_covariance_psd, outputs) == expected["28"]
    assert violating_rows(rules.empty_cells_inert, outputs) == expected["30"]


@SEEDS
@DTYPES
def test_rows_are_judged_by_the_cell_that_they_belong_to(seed: int, dtype: type) -> None:
    outputs = emission(seed, dtype)
    assert outputs.cells is not None
    assert outputs.gaussians is not None
    hidden, far = set(), set()
    cells = outputs.cells.astype(np.float64).tolist()
    for number, row in enumerate(outputs.gaussians.astype(np.float64).tolist()):
        cell = cells[number // PER_CELL]
        if number >= outputs.count:
            continue
        if cell[3] == 0 and math.isfinite(row[3]) and row[3] != 0:
            hidden.add(number)
        whole = finite(row, False) and finite(cell, False)
        if whole and row[3] >= float(np.float32(1 / 255)) and cell[3] > 0:
            reach = 2 * math.sqrt(max(cell[4] + cell[7] + cell[9], 0))
            if dtype is np.float16:
                reach += 2.0**-10 * sum(map(abs, cell[:3]))
            if math.dist(row[:3], cell[:3]) > reach:
                far.add(number)
    assert violating_rows(rules.hidden_cells_inert, outputs) == hidden
    assert violating_rows(rules.rows_near_their_cell, outputs) == far


def test_the_made_up_cells_break_every_rule() -> None:
    outputs = [emission(seed, np.float32) for seed in range(6)]
    for rule in (
        rules.cells_finite,
        rules.visibility_range,
        rules.cell_covariance_psd,
        rules.hidden_cells_inert,
        rules.empty_cells_inert,
        rules.rows_near_their_cell,
    ):
        assert any(violating_rows(rule, outputs_of_seed) for outputs_of_seed in outputs), rule.id
