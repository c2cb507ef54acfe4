"""Statistical rules name mistakes that are made in random right scenes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from contract.rules.pictures.test_right_scenes import RULES, outputs_of_a_right_scene
from gsgen.contract.probing.drawn_sample import draw_sample
from gsgen.contract.probing.outputs import ModelOutputs

SEEDS = range(40, 44)


def findings(outputs: ModelOutputs) -> dict[str, str]:
    sample = draw_sample(outputs)
    assert sample is not None
    return {rule.id: v.actual for rule in RULES for v in rule.check(sample)}


def edited(
    outputs: ModelOutputs,
    *,
    rows: Callable[[np.ndarray], np.ndarray] = lambda rows: rows,
    color: Callable[[np.ndarray], np.ndarray] = lambda color: color,
) -> ModelOutputs:
    assert outputs.gaussians is not None
    assert outputs.appearance is not None
    return replace(
        outputs,
        gaussians=rows(outputs.gaussians.astype(np.float32)),
        appearance=color(outputs.appearance.astype(np.float32)),
    )


def shrunk(rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows[:, :4], rows[:, 4:] * np.float32(1e-3)], axis=1)


def clamped(rows: np.ndarray) -> np.ndarray:
    opacity = np.clip(rows[:, 3], 1e-3, 1 - 1e-3)
    rows[:, 3] = np.clip(np.log(opacity / (1 - opacity)), 0, 1)
    return rows


@pytest.mark.parametrize("kind", ["surface", "room"])
@pytest.mark.parametrize("seed", SEEDS)
def test_sparse_surface_discs_are_not_reported_as_dust(kind, seed: int) -> None:
    outputs = outputs_of_a_right_scene(kind, seed)
    assert "GV040" in findings(edited(outputs, rows=shrunk))


@pytest.mark.parametrize("seed", SEEDS)
def test_dust_fixture_gives_no_scale_finding(seed: int) -> None:
    """Round Gaussians far apart follow no surface."""

    def as_dust(rows: np.ndarray) -> np.ndarray:
        rows[:, 4:] = np.mean(rows[:, [4, 7, 9]]) * np.array([1, 0, 0, 1, 0, 1]) * 1e-3
        return rows

    outputs = outputs_of_a_right_scene("surface", seed)
    assert "follow the surface" not in findings(edited(outputs, rows=as_dust)).get("GV040", "")


def test_clamped_logits_are_named() -> None:
    named = [
        findings(edited(outputs_of_a_right_scene("surface", seed), rows=clamped)).get("GV043", "")
        for seed in range(12)
    ]
    # Scenes of equal opacities have no logits on both sides.
    assert sum("logits were clamped" in text for text in named) >= 6


def harmonics(seed: int) -> ModelOutputs:
    """Return the next random scene with SH of degree 3 whose highlights are nearly grey."""
    for number in range(seed, seed + 100):
        outputs = outputs_of_a_right_scene("surface", number)
        if outputs.is_sh and outputs.appearance is not None and outputs.appearance.shape[1] == 48:
            red, green = outputs.appearance[:, [12, 13]].astype(np.float64).T
            if red.any() and 0.6 < np.corrcoef(red, green)[0, 1] < 0.99:
                return outputs
    raise AssertionError("no scene has degree 3")


def by_degree(color: np.ndarray) -> np.ndarray:
    parts = np.split(color.reshape(len(color), 16, 3), [1, 4, 9], axis=1)
    return np.concatenate([p.transpose(0, 2, 1).reshape(len(color), -1) for p in parts], axis=1)


def in_blocks(color: np.ndarray) -> np.ndarray:
    sh_rest = color.reshape(len(color), 16, 3)[:, 1:].transpose(0, 2, 1)
    padded = np.pad(sh_rest, ((0, 0), (0, 0), (0, 1))).reshape(len(color), -1)
    return np.concatenate([color[:, :3], padded[:, :45]], axis=1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (by_degree, "each degree is read channel-major"),
        (in_blocks, "in blocks of 16"),
        (lambda color: np.roll(color, 1, axis=1), "from number 1 on"),
        (lambda color: np.roll(color, 2, axis=1), "from number 2 on"),
    ],
)
@pytest.mark.parametrize("seed", [0, 100])
def test_other_orders_of_coefficients_are_named(change, words: str, seed: int) -> None:
    assert words in findings(edited(harmonics(seed), color=change)).get("GV048", "")


def test_columns_that_begin_with_the_normals_are_named() -> None:
    """The normals of a PLY are zero, and stand before its colours."""
    outputs = edited(harmonics(0), color=lambda c: np.c_[np.zeros((len(c), 3)), c[:, :-3]])
    assert "coefficients of degree 0" in findings(outputs).get("GV046", "")
