"""Hash grids against a loop in float64, with Python's integers; inverses against NumPy's."""

import numpy as np
import pytest
import torch

from gsgen.sdk import GeneratorInvalid, math


def oracle(table: np.ndarray, point: np.ndarray, resolution: int) -> np.ndarray:
    """The feature at one point: eight corners, each with a volume for its weight."""
    scaled = np.clip(point.astype(np.float64), 0, 1) * resolution
    low = np.minimum(np.floor(scaled), resolution - 1)
    total = np.zeros(table.shape[1])
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, scaled - low, 1 - (scaled - low)))
        x, y, z = (int(number) for number in low + corner)
        if (resolution + 1) ** 3 <= len(table):
            row = x + (resolution + 1) * (y + (resolution + 1) * z)
        else:
            row = (x ^ (y * 2654435761) ^ (z * 805459861)) % len(table)
        total += weight * table[row]
    return total


@pytest.mark.parametrize(
    ("size", "resolution"), [(64, 3), (64, 4), (1 << 12, 100), (1 << 19, 2048)]
)
def test_features_are_those_of_the_paper(size: int, resolution: int) -> None:
    rng = np.random.default_rng(resolution)
    table = rng.normal(size=(size, 2)).astype(np.float32)
    corners = np.array([[0, 0, 0], [1, 1, 1], [-3, 0.5, 7], [1, 0, 0.25]])
    points = np.concatenate([rng.random((60, 3)), corners]).astype(np.float32)
    features = math.hash_grid([torch.tensor(table)], torch.tensor(points), (resolution,))
    expected = [oracle(table, point, resolution) for point in points]
    # A coordinate of 2,048 cells has 13 bits of float32 left for the share between two corners.
    np.testing.assert_allclose(features.numpy(), expected, atol=2e-6 * max(resolution, 8))


def test_levels_are_joined_in_order() -> None:
    tables, points = [torch.randn(32, 2), torch.randn(32, 3)], torch.rand(7, 3)
    joined = math.hash_grid(tables, points, (2, 9))
    assert joined.shape == (7, 5)
    torch.testing.assert_close(joined[:, 2:], math.hash_grid(tables[1:], points, (9,)))


@pytest.mark.parametrize(("size", "resolution"), [(60, 9), (1 << 24, 1 << 10)])
def test_a_table_that_a_hash_does_not_fit_is_refused(size: int, resolution: int) -> None:
    with pytest.raises(GeneratorInvalid, match=f"{size} rows.*power of two"):
        math.hash_grid([torch.zeros(1, 1).expand(size, 1)], torch.zeros(1, 3), (resolution,))


def test_tables_and_resolutions_must_pair() -> None:
    with pytest.raises(GeneratorInvalid, match="2 tables, expected one for each of 1"):
        math.hash_grid([torch.zeros(8, 1)] * 2, torch.zeros(1, 3), (4,))


def test_inverses_are_those_of_numpy_and_singular_matrices_stay_finite() -> None:
    rng = np.random.default_rng(0)
    matrices = rng.normal(size=(50, 3, 3))
    inverses = math.inverse_3x3(torch.tensor(matrices)).numpy()
    np.testing.assert_allclose(inverses, np.linalg.inv(matrices), rtol=1e-9, atol=1e-9)
    singular = torch.stack([torch.zeros(3, 3), torch.ones(3, 3)])
    assert torch.isfinite(math.inverse_3x3(singular)).all()
