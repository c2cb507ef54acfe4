"""Rows of a frame become scales, quaternions and SH without a loss that float32 shows."""

import numpy as np

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.layout import DecodedGaussians
from gsgen.runtime.baking.frame_splats import drawn_mask, splats_of_frame


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
