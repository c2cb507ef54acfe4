"""A sample's neighbours and statistics against oracles that look at one row at a time."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.drawn_sample import MIN_DRAWN_ROWS, draw_sample
from gsgen.contract.probing.outputs import ModelOutputs


def outputs(rows: np.ndarray, color: np.ndarray | None = None, count: int | None = None):
    return ModelOutputs(
        probe="p",
        zeros=False,
        outputs={},
        gaussians=rows,
        appearance=color,
        count=len(rows) if count is None else count,
        declared=None,
        subject=cast(InspectedModel, SimpleNamespace()),
    )


def random_rows(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(count, 3, 3)) * rng.uniform(0.01, 0.3, (count, 1, 3))
    sigma = factor @ factor.transpose(0, 2, 1)
    rows = np.zeros((count, 10), np.float32)
    rows[:, :3] = rng.normal(size=(count, 3)) * rng.uniform(0.5, 3, 3)
    rows[:, 3] = rng.uniform(0.1, 1, count)
    rows[:, 4:] = sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return rows


@pytest.mark.parametrize("count", [MIN_DRAWN_ROWS, 200, 1024, 1025, 9000])
def test_neighbours_are_the_nearest_rows_of_the_whole_scene(count: int) -> None:
    rows = random_rows(count, count)
    sample = draw_sample(outputs(rows))
    assert sample is not None
    expected, _ = cKDTree(rows[:, :3].astype(float)).query(
        sample.rows[sample.inner_indices][:, :3], k=1 + sample.neighbours.shape[1]
    )
    distance = np.linalg.norm(sample.offsets, axis=2)
    np.testing.assert_allclose(distance, expected[:, 1:], rtol=1e-6)
    np.testing.assert_allclose(sample.spacing, expected[:, 1:4].mean(axis=1), rtol=1e-6)


def test_statistics_of_a_row_are_those_of_a_loop_over_its_neighbours() -> None:
    sample = draw_sample(outputs(random_rows(300, 5)))
    assert sample is not None
    for number, row in enumerate(sample.inner_indices[:40]):
        upper = sample.rows[row, 4:]
        matrix = upper[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)
        variances, axes = np.linalg.eigh(matrix)
        np.testing.assert_allclose(sample.sigma[number], np.sqrt(variances), rtol=1e-6)
        cosines = []
        for neighbour in sample.neighbours[number]:
            offset = sample.rows[neighbour, :3] - sample.rows[row, :3]
            cosines.append(float(offset @ axes[:, 0] / np.linalg.norm(offset)))
        share = np.mean(np.square(cosines))
        assert sample.neighbour_alignment(0)[number] == pytest.approx(share, abs=1e-9)
        assert np.trace(sample.scatter[number]) == pytest.approx(1)


def test_invisible_rows_are_not_sampled() -> None:
    rows = random_rows(100, 1)
    color = np.zeros((100, 3), np.float32)
    rows[::7, 3] = 0.001
    rows[1, 5] = np.nan
    color[2, 0] = np.inf
    sample = draw_sample(outputs(rows, color, count=90))
    assert sample is not None
    hidden = {*range(0, 90, 7), 1, 2}
    assert sample.count == 90 - len(hidden)
    assert np.isfinite(sample.rows).all()
    assert (sample.rows[:, 3] > 0.01).all()


def test_few_rows_give_no_sample() -> None:
    assert draw_sample(outputs(random_rows(MIN_DRAWN_ROWS - 1, 0))) is None
    assert draw_sample(outputs(random_rows(200, 0), count=MIN_DRAWN_ROWS - 1)) is None


def test_equal_positions_and_flat_covariances_give_finite_statistics() -> None:
    rows = random_rows(64, 3)
    rows[:, :3] = 1
    rows[:, 4:] = 0
    sample = draw_sample(outputs(rows))
    assert sample is not None
    for values in (sample.spacing, sample.sigma, sample.scatter, sample.neighbour_alignment(2)):
        assert np.isfinite(values).all()
