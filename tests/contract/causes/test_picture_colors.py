"""Colours of pictures that a model changes by mistake: each change is named, an effect is not."""

import numpy as np
import pytest

from gsgen.contract.causes.picture_colors import _READINGS, color_error, explain_colors
from gsgen.contract.spec.srgb import srgb_of_linear


def picture(seed: int, count: int = 400) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 0.9, (count, 3))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", _READINGS)
def test_each_reading_is_named(name: str, seed: int) -> None:
    colors = picture(seed)
    noise = np.random.default_rng(seed + 9).normal(0, 1e-3, colors.shape)
    reading = explain_colors(colors, _READINGS[name][0](colors) + noise)
    assert reading is not None
    # the sRGB curve and the power 2.2 are a hundredth apart
    similar = {"decoded": "2.2", "twice": "twice"}
    assert reading.name == name or any(a in name and b in reading.name for a, b in similar.items())


@pytest.mark.parametrize("seed", range(3))
def test_effects_and_networks_are_not_blamed(seed: int) -> None:
    random = np.random.default_rng(seed)
    colors = picture(seed)
    mixing = random.normal(0, 1, (3, 3))
    grey = np.repeat(colors.mean(axis=1, keepdims=True), 3, axis=1)
    for effect in (
        colors,
        1 - colors,
        grey,
        np.clip(1.2 * colors - 0.1, 0, 1),
        colors + (colors**2 - colors) * 0.7,
        1 / (1 + np.exp(-colors @ mixing)),
        random.uniform(0, 1, colors.shape),
        np.full_like(colors, 0.3),
    ):
        assert explain_colors(colors, effect) is None
    assert explain_colors(colors[:8], colors[:8, ::-1]) is None, "too few pixels"


def test_colours_of_other_pixels_are_named() -> None:
    colors = picture(4)
    reading = explain_colors(colors, colors[::-1], {"upside down": (colors[::-1], "Turn it.")})
    assert reading is not None
    assert (reading.name, reading.hint, reading.error) == ("upside down", "Turn it.", 0.0)
    assert reading.declared == color_error(colors, colors[::-1])


def test_encoding_is_the_standard_curve() -> None:
    """IEC 61966-2-1 gives 0.5 as 188/255 and the straight part below 0.0031308."""
    np.testing.assert_allclose(
        srgb_of_linear(np.array([0.0, 0.002, 0.5, 1.0])), [0, 0.02584, 0.735357, 1], atol=1e-5
    )
