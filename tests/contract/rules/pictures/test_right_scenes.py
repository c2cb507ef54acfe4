"""Statistical rules stay silent on scenes that are drawn at random, and right."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.scenes import SCENE_KINDS, Kind, pack, scene
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.drawn_sample import draw_sample
from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.rules.catalogue import builtin_rules
from gsgen.contract.spec.layout import encode
from gsgen.contract.spec.manifest import AppearanceOutput, GaussiansOutput

RULES = [rule for rule in builtin_rules() if rule.scope == "sample"]
SEEDS = 12


def outputs_of_a_right_scene(kind: Kind, seed: int) -> ModelOutputs:
    """Return packed rows of a scene whose size, units, appearance and dtype are drawn at random."""
    random = np.random.default_rng([seed, 5])
    count = int(np.exp(random.uniform(np.log(100), np.log(4000))))
    parts = scene(kind, count, seed, has_training=bool(random.random() < 0.7))
    size, thickness = np.exp(random.uniform(np.log((0.6, 0.4)), np.log((2, 2.5))))
    parts = replace(parts, scale=parts.scale * (size, size, size * thickness))
    degree = (None, 0, 1, 2, 3)[random.integers(5)]
    gaussians = pack(parts, degree)
    unit = 10.0 ** random.uniform(-1, 1)
    dtype = (np.float32, np.float32, np.float16)[random.integers(3)]
    rows, color = encode(gaussians, np.float32)
    rows[:, :3] *= unit
    rows[:, 4:] *= unit**2
    declared = AppearanceOutput("color", "rgb" if degree is None else "sh", degree)
    subject = SimpleNamespace(
        declared_gaussians=GaussiansOutput("gaussians", count),
        declared_appearance=declared,
        generator=None,
    )
    return ModelOutputs(
        probe="no inputs",
        zeros=False,
        outputs={},
        gaussians=rows.astype(dtype),
        appearance=color.astype(dtype),
        count=count,
        declared=declared,
        subject=cast(InspectedModel, subject),
    )


@pytest.mark.parametrize("kind", SCENE_KINDS)
@pytest.mark.parametrize("seed", range(SEEDS))
def test_no_statistical_rule_suspects_a_right_scene(kind: Kind, seed: int) -> None:
    sample = draw_sample(outputs_of_a_right_scene(kind, seed))
    assert sample is not None
    findings = {rule.id: [v.actual for v in rule.check(sample)] for rule in RULES}
    assert {id: texts for id, texts in findings.items() if texts} == {}


def sparse_outputs(positions: np.ndarray, scales: np.ndarray) -> ModelOutputs:
    """Packed rows of round or long Gaussians along the axes, as small modules return them."""
    parts = outputs_of_a_right_scene("cloud", 0)
    rows = np.zeros((len(positions), 10), np.float32)
    rows[:, :3], rows[:, 3], rows[:, [4, 7, 9]] = positions, 0.8, np.square(scales)
    color = np.random.default_rng(0).uniform(0.1, 0.9, (len(positions), 3)).astype(np.float32)
    declared = AppearanceOutput("color", "rgb", None)
    return replace(parts, gaussians=rows, appearance=color, count=len(positions), declared=declared)


SIZES = {
    "0.1": lambda random, n: np.full((n, 3), 0.1),
    "0.05": lambda random, n: np.full((n, 3), 0.05),
    "0.03": lambda random, n: np.full((n, 3), 0.03),
    "0.02": lambda random, n: np.full((n, 3), 0.02),
    "around 0.05": lambda random, n: np.exp(random.normal(size=(n, 3)) * 0.2 - 3),
    "around 0.03": lambda random, n: np.exp(random.normal(size=(n, 3)) * 0.3 - 3.5),
    "from 0.02 to 0.06": lambda random, n: random.uniform(0.02, 0.06, (n, 1)) * np.ones(3),
    "as a softplus": lambda random, n: np.log1p(np.exp(random.normal(size=(n, 3)) - 3)),
}
POSITIONS = {
    "normal": lambda random, n: random.normal(size=(n, 3)),
    "uniform": lambda random, n: random.uniform(-1, 1, (n, 3)),
    "flat": lambda random, n: random.normal(size=(n, 3)) * [1, 1, 0.1],
}


@pytest.mark.parametrize("count", [64, 100, 192, 300, 400, 800])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", POSITIONS)
def test_small_gaussians_of_a_sparse_cloud_are_not_suspected(
    kind: str, size: str, count: int
) -> None:
    random = np.random.default_rng(count)
    positions, scales = POSITIONS[kind](random, count), SIZES[size](random, count)
    sample = draw_sample(sparse_outputs(positions, scales))
    assert sample is not None
    assert [v.actual for rule in RULES if rule.id == "GV040" for v in rule.check(sample)] == []
