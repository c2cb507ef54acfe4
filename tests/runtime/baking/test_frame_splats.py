"""Rows of a frame become scales, quaternions and SH without a loss that float32 shows."""

import numpy as np
import pytest

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.layout import DecodedGaussians
from gsgen.runtime.baking.frame_splats import drawn_mask, scales_and_quaternions, splats_of_frame


def _cloud(count: int, **changes: np.ndarray) -> DecodedGaussians:
    rng = np.random.default_rng(count)
    scale, rotation = rng.uniform(0.01, 2, (count, 3)), rng.normal(size=(count, 4))
    arrays = {
        "position": rng.normal(size=(count, 3)).astype(np.float32),
        "opacity": rng.uniform(0.1, 1, count).astype(np.float32),
        "covariance": covariance_upper(scale, rotation).astype(np.float32),
        "rgb": rng.uniform(-0.2, 1.3, (count, 3)).astype(np.float32),
    }
    return DecodedGaussians(**(arrays | changes))


@pytest.mark.parametrize("span", [0.0, 2.0, 5.0])
def test_random_covariances_round_trip(span: float) -> None:
    """Axes differ by up to ``span`` decades; the error is relative to the trace."""
    rng = np.random.default_rng(int(span))
    scale = 10 ** rng.uniform(-span, 0, (500, 3))
    covariance = covariance_upper(scale, rng.normal(size=(500, 4)))
    scales, quaternions = scales_and_quaternions(covariance)
    again = covariance_upper(scales, quaternions.astype(np.float64))
    trace = covariance[:, [0, 3, 5]].sum(axis=1)
    assert np.abs(again - covariance).max(axis=1).max() < 1e-6
    assert (np.abs(again - covariance).max(axis=1) / trace).max() < 5e-7
    np.testing.assert_allclose(scales, np.sort(scale, axis=1), rtol=1e-4, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1, atol=1e-6)
    assert (quaternions[:, 0] >= 0).all()


def test_signs_do_not_depend_on_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    covariance = _cloud(200).covariance
    expected = scales_and_quaternions(covariance)[1]
    solve, rng = np.linalg.eigh, np.random.default_rng(1)

    def flipped(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, vectors = solve(matrices)
        return values, vectors * rng.choice([-1.0, 1.0], (len(vectors), 1, 3))

    monkeypatch.setattr(np.linalg, "eigh", flipped)
    np.testing.assert_array_equal(scales_and_quaternions(covariance)[1], expected)


def test_flat_balls_and_rounded_covariances_have_finite_parameters() -> None:
    flat = [[1, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 0], [1, 0, 0, 1, 0, 1], [1, 1, 1, 1, 1, 0.999]]
    splats = splats_of_frame(_cloud(4, covariance=np.array(flat, np.float32)))
    assert np.isfinite(splats.log_scale).all()
    assert np.isfinite(splats.rotation).all()


def test_colors_opacities_and_positions_survive() -> None:
    cloud = _cloud(100)
    splats = splats_of_frame(cloud)
    assert splats.degree == 0
    np.testing.assert_array_equal(splats.position, cloud.position)
    color = 0.5 + splats.sh[:, 0] / (2 * np.sqrt(np.pi))
    np.testing.assert_allclose(color, cloud.rgb, atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-splats.logit_opacity)), cloud.opacity, atol=1e-6)


def test_invisible_and_nonfinite_rows_are_not_drawn() -> None:
    opacity = np.array([1 / 255, 0.0039, 0.0, np.nan, 0.5, 0.5], np.float32)
    position = np.zeros((6, 3), np.float32)
    position[4, 1] = np.inf
    mask, nonfinite = drawn_mask(_cloud(6, opacity=opacity, position=position))
    assert mask.tolist() == [True, False, False, False, False, True]
    assert nonfinite == 2
