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
