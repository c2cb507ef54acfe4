"""The fit of SH against coefficients that are known."""

import numpy as np
import pytest

from gsgen.contract.spec.spherical_harmonics import evaluate
from gsgen.runtime.baking.sh_fit import best_degree, color_errors, fit_sh

N, VIEWS = 60, 30


def _synthetic_views(
    degree: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, eyes, colours and the coefficients that gave them."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(N, 3))
    eyes = rng.normal(size=(VIEWS, 3))
    eyes *= 8 / np.linalg.norm(eyes, axis=1, keepdims=True)
    sh = 0.03 * rng.normal(size=(N, (degree + 1) ** 2, 3))  # too small to be clamped at 0
    rays = positions[None] - eyes[:, None]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    colors = np.stack(
        [
            np.stack([evaluate(sh[n : n + 1], rays[v, n : n + 1])[0, 0] for n in range(N)])
            for v in range(VIEWS)
        ]
    )
    return positions, eyes, colors, sh


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_known_coefficients_are_recovered(degree: int) -> None:
    positions, eyes, colors, sh = _synthetic_views(degree)
    weights = np.random.default_rng(1).uniform(0.2, 1, (VIEWS, N))
    fitted = fit_sh(positions, eyes, colors, weights, degree)
    np.testing.assert_allclose(fitted, sh, atol=2e-5)
    assert color_errors(positions, eyes, colors, weights, fitted) < 1e-5


def test_a_weight_of_zero_takes_a_camera_out() -> None:
    positions, eyes, colors, sh = _synthetic_views(2)
    weights = np.ones((VIEWS, N))
    weights[3], colors[3] = 0, 1e3
    np.testing.assert_allclose(fit_sh(positions, eyes, colors, weights, 2), sh, atol=2e-5)


def test_a_gaussian_that_one_camera_sees_has_its_color_there() -> None:
    positions, eyes, colors, _ = _synthetic_views(1)
    weights = np.zeros((VIEWS, N))
    weights[4] = 0.7
    fitted = fit_sh(positions, eyes, colors, weights, 3)
    assert np.isfinite(fitted).all()
    assert color_errors(positions, eyes, colors, weights, fitted) < 1e-3


def test_gaussians_that_no_camera_sees_are_grey() -> None:
    positions, eyes, colors, _ = _synthetic_views(1)
    fitted = fit_sh(positions, eyes, colors, np.zeros((VIEWS, N)), 3)
    np.testing.assert_array_equal(fitted, 0)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_held_out_error_chooses_the_degree_of_the_colors(degree: int) -> None:
    positions, eyes, colors, _ = _synthetic_views(degree, seed=7)
    weights = np.ones((VIEWS, N))
    train_slice, test = slice(0, 24), slice(24, None)
    errors = [
        color_errors(
            positions,
            eyes[test],
            colors[test],
            weights[test],
            fit_sh(
                positions,
                eyes[train_slice],
                colors[train_slice],
                weights[train_slice],
                candidate_degree,
            ),
        )
        for candidate_degree in range(4)
    ]
    assert best_degree(errors) == degree
