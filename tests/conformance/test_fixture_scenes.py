"""Fixtures have the statistics that their descriptions state."""

import numpy as np

from gsgen.conformance.fixtures import find
from gsgen.contract.spec.layout import POSITION


def rows_of(name: str) -> np.ndarray:
    """Return the packed rows that a fixture's model outputs."""
    weights = find(name).draw().weights
    (rows,) = [x for x in weights.values() if x.ndim == 2 and x.shape[1] == 10]
    return np.asarray(rows, np.float64)


def variances_of(name: str) -> np.ndarray:
    """Return the variances along the axes of each Gaussian, ascending."""
    upper = rows_of(name)[:, 4:]
    return np.linalg.eigvalsh(upper[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]])


def test_half_specks_are_disks_of_a_thousandth() -> None:
    deviations = np.sqrt(np.abs(variances_of("half_specks")))
    np.testing.assert_allclose(deviations[:, 1:], 1e-3, rtol=0.05)  # steps of 6e-8 in float16
    assert (deviations[:, 0] < 4e-4).all()


def test_a_synthetic_room_is_of_equal_discs_and_a_trained_one_is_not() -> None:
    rows, variances = rows_of("synthetic_room"), variances_of("synthetic_room")
    assert np.ptp(rows[:, 3]) == 0
    np.testing.assert_allclose(variances, np.tile(variances[0], (len(rows), 1)), rtol=1e-3)
    assert variances[0, 0] < 0.01 * variances[0, 1]
    walls = (np.abs(rows[:, POSITION]) >= 0.999 * np.abs(rows[:, POSITION]).max(axis=0)).any(axis=1)
    assert walls.all()
    assert np.ptp(rows_of("trained_surface")[:, 3]) > 0.1
