"""Rotations fitted to neighbourhoods, against SciPy's solution of Wahba's problem, row by row."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contract.probing.test_drawn_sample import outputs, random_rows
from gsgen.contract.probing.drawn_sample import draw_sample, fit_local_rotations

COUNT = 60


def moved_rows(rows: np.ndarray, position: np.ndarray) -> np.ndarray:
    moved_sample = rows.astype(np.float64)
    moved_sample[:, :3] = position
    return moved_sample


def sample_of(seed: int):
    rows = random_rows(COUNT, seed)
    rows[:, 3] = 0.9
    sample = draw_sample(outputs(rows.astype(np.float32)))
    assert sample is not None
    return sample


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.5])
def test_each_rotation_is_the_one_that_scipy_fits(seed, noise):
    sample, rng = sample_of(seed), np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    moved_sample = moved_rows(sample.rows, sample.rows[:, :3] @ turn.T + [3, -1, 2])
    moved_sample[:, :3] += noise * rng.normal(size=(len(moved_sample), 3))
    fitted = fit_local_rotations(sample, moved_sample)
    for index, row in enumerate(sample.inner_indices):
        before = sample.rows[sample.neighbours[index], :3] - sample.rows[row, :3]
        after = moved_sample[sample.neighbours[index], :3] - moved_sample[row, :3]
        expected, _ = Rotation.align_vectors(after, before)
        np.testing.assert_allclose(fitted.rotation[index], expected.as_matrix(), atol=1e-6)
        assert fitted.angle[index] == pytest.approx(expected.magnitude(), abs=1e-5)


def test_a_mirrored_neighbourhood_gets_a_rotation_and_is_not_rigid():
    sample = sample_of(7)
    fitted = fit_local_rotations(sample, moved_rows(sample.rows, sample.rows[:, :3] * [-1, 1, 1]))
    np.testing.assert_allclose(np.linalg.det(fitted.rotation), 1, atol=1e-9)
    assert not fitted.is_rigid.any()


def test_neighbours_on_a_line_leave_the_rotation_open():
    sample = sample_of(8)
    line = np.outer(np.arange(len(sample.rows)), [1.0, 2.0, 3.0])
    collinear_sample = sample_of_line(sample, line)
    assert not fit_local_rotations(
        collinear_sample, moved_rows(collinear_sample.rows, line @ np.eye(3))
    ).is_rigid.any()


def sample_of_line(sample, line):
    """Return the sample of the same rows with centres on a line."""
    rows = sample.rows.copy()
    rows[:, :3] = line
    drawn = draw_sample(outputs(rows.astype(np.float32)))
    assert drawn is not None
    return drawn
