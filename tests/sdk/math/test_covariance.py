import numpy as np
import pytest
import torch

from gsgen.contract.spec import geometry
from gsgen.sdk import math


def sample(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    quaternions = rng.normal(size=(n, 4)) * np.exp(rng.normal(0, 4, (n, 1)))
    scales = np.exp(rng.normal(-3, 2, (n, 3)))
    return scales.astype(np.float32), quaternions.astype(np.float32)


def test_covariances_are_those_of_the_oracle() -> None:
    scale, quaternions = sample(500)
    actual = math.covariance_upper(torch.from_numpy(scale), torch.from_numpy(quaternions)).numpy()
    expected = geometry.covariance_upper(scale, quaternions)
    trace = expected[:, [0, 3, 5]].sum(axis=1, keepdims=True)
    np.testing.assert_array_less(np.abs(actual - expected) / trace, 2e-6)


def test_upper_triangles_and_matrices_round_trip() -> None:
    upper = np.random.default_rng(1).normal(size=(7, 6)).astype(np.float32)
    full = math.covariance_matrix(torch.from_numpy(upper))
    np.testing.assert_array_equal(full.numpy(), geometry.symmetric(upper))
    np.testing.assert_array_equal(math.upper_triangle(full).numpy(), upper)


@pytest.mark.parametrize("per_row", [False, True])
def test_a_linear_map_of_a_covariance_is_that_of_the_oracle(per_row: bool) -> None:
    n = 300
    turn = np.random.default_rng(4).normal(size=(n, 3, 3) if per_row else (3, 3))
    turn = turn.astype(np.float32)
    upper = geometry.covariance_upper(*sample(n)).astype(np.float32)
    actual = math.rotate_covariance(torch.from_numpy(upper), torch.from_numpy(turn)).numpy()
    double_precision = turn.astype(np.float64)
    full = double_precision @ geometry.symmetric(upper) @ double_precision.swapaxes(-1, -2)
    expected = full[:, geometry.COVARIANCE_INDEX[0], geometry.COVARIANCE_INDEX[1]]
    size = np.abs(
        np.linalg.norm(double_precision, axis=(-2, -1)) ** 2 * upper[:, [0, 3, 5]].sum(axis=1)
    )
    np.testing.assert_array_less(np.abs(actual - expected).max(axis=1) / size, 2e-6)
