"""Each explanation of values out of range is a repair after which they are in range."""

from collections.abc import Callable

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.clouds import cloud
from gsgen.contract.causes.activations import explain_opacity, explain_rgb, explain_variances

RNG = np.random.default_rng(5)
OPACITY = RNG.uniform(0.02, 0.99, 300)
RGB = RNG.uniform(0.02, 0.99, (300, 3))


def logit(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.log(values / (1 - values)))


@pytest.mark.parametrize(
    ("values", "repair"),
    [
        (np.round(255 * OPACITY), "divide by 255"),
        (100 * OPACITY, "divide by 100"),
        (np.tanh(logit(OPACITY) / 2), "use (x + 1) / 2"),
        (3 * logit(OPACITY), "apply the sigmoid"),
        (1.3 * OPACITY, "clamp them"),
        (1.2 * OPACITY - 0.1, "clamp them"),
    ],
)
def test_opacity_is_explained_by_its_repair(values: np.ndarray, repair: str) -> None:
    cause = explain_opacity(values)
    assert cause is not None
    assert cause[1] == repair


def test_opacities_that_no_repair_shows_have_no_cause() -> None:
    assert explain_opacity(np.full(300, -np.inf)) is None
    assert explain_opacity(np.full(300, -20.0)) is None  # the sigmoid leaves nothing to see


@pytest.mark.parametrize(
    "activation",
    [np.exp, lambda x: np.log1p(np.exp(x)), lambda x: np.maximum(x, 0), lambda x: 5 * OPACITY],
)
def test_other_activations_are_neither_percent_nor_a_missing_clamp(
    activation: Callable[[np.ndarray], np.ndarray],
) -> None:
    assert explain_opacity(activation(2 * logit(OPACITY))) is None
    assert explain_rgb(activation(2 * logit(RGB[:, 0]))[:, None] * np.ones(3)) is None


@pytest.mark.parametrize(
    ("values", "repair"),
    [
        (np.round(255 * RGB), "divide by 255"),
        (1.3 * RGB, "clamp them"),
        (2 * RGB - 1, "use (x + 1) / 2"),
        ((RGB - 0.5) / 0.28209479, "use 0.5 + 0.28209479 · f_dc"),
        (3 * logit(RGB), "apply the sigmoid activation"),
    ],
)
def test_colours_are_explained_by_their_repair(values: np.ndarray, repair: str) -> None:
    cause = explain_rgb(values)
    assert cause is not None
    assert cause[1] == repair


def test_variances_are_explained_by_their_repair() -> None:
    covariance = cloud(200, seed=1).covariance
    diagonal = covariance * [1, 0, 0, 1, 0, 1]
    logs = np.where(diagonal > 0, np.log(np.sqrt(np.maximum(diagonal, 1e-9))), 0)
    for values, repair in (
        (-covariance, "negate the covariance"),
        (logs, "apply exp, then square"),
    ):
        cause = explain_variances(values)
        assert cause is not None
        assert repair in ": ".join(cause)
    mixed = covariance * np.where(np.arange(200) % 2, 1, -1)[:, None]
    assert explain_variances(mixed) is None
