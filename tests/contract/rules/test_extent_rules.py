"""Rules of place and size against oracles that look at one row at a time."""

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs, Rows
from gsgen.contract.rules.values import extent
from gsgen.contract.spec.manifest import Bounds, GaussiansOutput

BOX = Bounds((-2.0, -2.0, -2.0), (2.0, 2.0, 2.0))
SUBJECT = SimpleNamespace(
    declared_gaussians=GaussiansOutput("gaussians", 1),
    generator=SimpleNamespace(bounds=BOX),
    target=SimpleNamespace(limits={"subnormal_permille": 100}),
)


def random_rows(dtype: type, seed: int) -> Rows:
    rng = np.random.default_rng(seed)
    rows = np.zeros((200, 10))
    rows[:, :3] = rng.normal(size=(200, 3)) * 10.0 ** rng.uniform(-2, 2, (200, 1))
    rows[:, 3] = rng.uniform(0, 1, 200) > 0.2
    rows[:, [4, 7, 9]] = 10.0 ** rng.uniform(-7, 2, (200, 3))
    rows[rng.integers(0, 200, 3)] = np.nan
    packed = rows.astype(dtype)
    emission = ModelOutputs(
        probe="p",
        zeros=False,
        outputs={},
        gaussians=packed,
        appearance=None,
        count=150,
        declared=None,
        subject=cast(InspectedModel, SUBJECT),
    )
    return Rows(emission, 0, packed, None)


def bad_rows(rule, rows: Rows) -> set[int]:
    with np.errstate(all="ignore"):
        return {int(i) for breach in rule.check(rows) for i in np.flatnonzero(breach.invalid_rows)}


def coarse(row: list[float]) -> bool:
    max_coordinate = max(map(abs, row[:3]))
    step = 2.0 ** (math.floor(math.log2(max(max_coordinate, 2.0**-14))) - 10)
    return step * step > max(row[4], row[7], row[9]) > 0


def outside(row: list[float]) -> bool:
    tolerance = 1e-3 * math.sqrt(48) + (2 * 2.0**-10)
    return not all(abs(value) <= 2 + tolerance for value in row[:3])


ORACLES = {
    "GV008": (
        extent.variance_not_subnormal,
        lambda row: 0 < max(row[4], row[7], row[9]) < 2.0**-14,
    ),
    "GV009": (extent.position_resolution, coarse),
    "GV011": (extent.size_within_bounds, lambda row: max(row[4], row[7], row[9]) > 48),
    "GV021": (extent.centres_within_bounds, outside),
}


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("id", ORACLES)
def test_rule_reports_the_rows_that_its_oracle_rejects(id: str, seed: int) -> None:
    rule, rejects = ORACLES[id]
    rows = random_rows(np.float16, seed)
    expected = {
        index
        for index, row in enumerate(rows.packed.astype(float).tolist())
        if index < 150 and all(map(math.isfinite, row)) and row[3] and rejects(row)
    }
    assert rule.id == id
    assert expected
    assert bad_rows(rule, rows) == expected


@pytest.mark.parametrize("id", ["GV008", "GV009"])
def test_float32_has_steps_and_numbers_that_are_fine_enough(id: str) -> None:
    assert not bad_rows(ORACLES[id][0], random_rows(np.float32, 0))
