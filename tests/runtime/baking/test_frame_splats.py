"""Rows of a frame become scales, quaternions and SH without a loss that float32 shows."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.layout import DecodedGaussians
from gsgen.formats import Splats
from gsgen.runtime.baking import frame_splats
from gsgen.runtime.baking.frame_splats import FrameConverter


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


def _splats(cloud: DecodedGaussians) -> Splats:
    return _converted(FrameConverter(), cloud)


def _converted(converter: FrameConverter, cloud: DecodedGaussians) -> Splats:
    return converter.convert(cloud, converter.drawn_mask(cloud)[0])


def test_flat_balls_and_rounded_covariances_have_finite_parameters() -> None:
    flat = [[1, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 0], [1, 0, 0, 1, 0, 1], [1, 1, 1, 1, 1, 0.999]]
    splats = _splats(_cloud(4, covariance=np.array(flat, np.float32)))
    assert np.isfinite(splats.log_scale).all()
    assert np.isfinite(splats.rotation).all()


def test_colors_opacities_and_positions_survive() -> None:
    cloud = _cloud(100)
    splats = _splats(cloud)
    assert splats.degree == 0
    np.testing.assert_array_equal(splats.position, cloud.position)
    color = 0.5 + splats.sh[:, 0] / (2 * np.sqrt(np.pi))
    np.testing.assert_allclose(color, cloud.rgb, atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-splats.logit_opacity)), cloud.opacity, atol=1e-6)


def test_invisible_and_nonfinite_rows_are_not_drawn() -> None:
    opacity = np.array([1 / 255, 0.0039, 0.0, np.nan, 0.5, 0.5], np.float32)
    position = np.zeros((6, 3), np.float32)
    position[4, 1] = np.inf
    mask, nonfinite = FrameConverter().drawn_mask(_cloud(6, opacity=opacity, position=position))
    assert mask.tolist() == [True, False, False, False, False, True]
    assert nonfinite == 2


def test_huge_numbers_are_finite_although_their_sum_is_not() -> None:
    position = np.full((3, 3), 3e38, np.float32)
    position[1, 2] = -np.inf
    mask, nonfinite = FrameConverter().drawn_mask(_cloud(3, position=position))
    assert (mask.tolist(), nonfinite) == ([True, False, True], 1)


def test_frames_in_sequence_are_as_frames_alone() -> None:
    """Rows keep, change, lose and regain covariances, colours and drawing; one row is added."""
    first, other = _cloud(50), _cloud(51)
    assert first.rgb is not None
    broken = first.rgb.copy()
    broken[4, 0] = np.nan
    covariance = first.covariance.copy()
    covariance[::3] = other.covariance[:50:3]
    opacity = np.where(np.arange(50) % 2, first.opacity, 0).astype(np.float32)
    sequence = FrameConverter()
    for cloud in (
        _cloud(50, opacity=opacity),
        first,
        _cloud(50, covariance=covariance, opacity=opacity),
        _cloud(50, covariance=covariance),
        _cloud(50, rgb=broken),
        first,
        other,
    ):
        actual, expected = _converted(sequence, cloud), _splats(cloud)
        for name in ("position", "rotation", "log_scale", "logit_opacity", "sh"):
            np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name))


def test_frames_that_keep_colors_share_their_coefficients() -> None:
    """Writers do not copy an array again that the last frame had."""
    first = _cloud(30)
    opacity = np.where(np.arange(30) % 3, first.opacity, 0).astype(np.float32)
    sequence = FrameConverter()
    whole = [_converted(sequence, replace(first, position=first.position + k)) for k in range(2)]
    assert whole[0].sh is whole[1].sh
    drawn = [_converted(sequence, replace(first, opacity=opacity)) for _ in range(2)]
    assert drawn[0].sh is drawn[1].sh
    assert len(drawn[0].sh) == 20
    other = _converted(sequence, replace(first, rgb=first.rgb + 0, opacity=opacity))
    assert other.sh is not drawn[0].sh


def test_an_unchanged_covariance_is_not_decomposed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []
    decompose = frame_splats.variances_and_quaternions

    def counting(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        counts.append(len(covariance))
        return decompose(covariance)

    monkeypatch.setattr(frame_splats, "variances_and_quaternions", counting)
    cloud = _cloud(20)
    covariance = cloud.covariance.copy()
    covariance[7, 3] += 1
    sequence, all_rows = FrameConverter(), np.ones(20, bool)
    for values in (cloud.covariance, cloud.covariance, covariance):
        sequence.convert(_cloud(20, covariance=values), all_rows)
    assert counts == [20, 0, 1]
