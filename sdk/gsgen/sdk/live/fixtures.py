"""Fixtures: models that violate a rule of validation level ``live`` and pass all lower levels.

They extend the corpus of :mod:`gsgen.conformance.fixtures`, whose models need no GPU.
"""

__all__ = ["live_fixtures"]

import sys

import numpy as np

from gsgen.conformance.fixtures import Fixture
from gsgen.conformance.fixtures.builders.arrays import f32, i64
from gsgen.conformance.fixtures.builders.fixture import fixtures_in, invalid
from gsgen.conformance.fixtures.builders.moving import SHIFT_NODE, drifting_model
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.severity import Level

_OUTPUT_NODE = "gaussians = Concat <axis = 1> (moved, opacity, spread)"
# More outputs than the default number of storage buffers per stage of any adapter.
_SPLIT_COUNT = 64


def live_fixtures() -> list[Fixture]:
    """Return one faulty example model for each rule of validation level ``live``."""
    return fixtures_in(sys.modules[__name__])


@invalid("GB011", level=Level.LIVE)
def integers_of_64_bits() -> ModelSpec:
    """Fixture: ONNX generator that adds and removes a number above 2³², which a GPU truncates."""
    counting_model = drifting_model().replace_text(
        SHIFT_NODE,
        "scaled = Mul (time, thousand) whole = Cast <to = 7> (scaled) far = Add (whole, big) "
        "back = Cast <to = 1> (far) near = Div (back, size) "
        "later = Add (near, time) shift = Mul (speed, later)",
    )
    large_constant = np.asarray([1 << 32], np.int64)
    return counting_model.with_weights(thousand=f32(1000), size=f32(1 << 32), big=large_constant)


@invalid("GB014", level=Level.LIVE)
def branches_by_if() -> ModelSpec:
    """Fixture: an ONNX generator with an If of different branches, which WebGPU cannot capture."""
    branching_model = drifting_model().replace_text(
        SHIFT_NODE,
        "late = Greater (time, half) turned = If (late) <then_branch = t () => (float[1] a) { a = Neg (time) }, "
        "else_branch = e () => (float[1] b) { b = Abs (time) }> "
        "shift = Mul (speed, turned)",
    )
    return branching_model.with_weights(half=f32(0.5))


@invalid("GB015", level=Level.LIVE)
def round_on_the_cpu() -> ModelSpec:
    """Fixture: an ONNX generator that rounds time to tenths by Round, which has no GPU kernel."""
    stepping_model = drifting_model().replace_text(
        SHIFT_NODE,
        "scaled = Mul (time, ten) whole = Round (scaled) step = Div (whole, ten) "
        "shift = Mul (speed, step)",
    )
    return stepping_model.with_weights(ten=f32(10))


@invalid("GB016", level=Level.LIVE)
def output_from_idle_sum() -> ModelSpec:
    """Fixture: an ONNX generator whose output is a ReduceSum over no axes, which is only a copy."""
    return drifting_model().replace_text(
        _OUTPUT_NODE,
        "packed = Concat <axis = 1> (moved, opacity, spread) "
        "gaussians = ReduceSum <noop_with_empty_axes = 1> (packed)",
    )


@invalid("GB017", level=Level.LIVE)
def split_into_many() -> ModelSpec:
    """Fixture: an ONNX generator with a Split into more outputs than a GPU kernel may bind."""
    parts = ", ".join(f"part_{index}" for index in range(_SPLIT_COUNT))
    splitting_model = drifting_model().replace_text(
        SHIFT_NODE,
        f"many = Expand (time, parts) {parts} = Split <axis = 0, num_outputs = {_SPLIT_COUNT}> (many) "
        "again = Add (part_0, part_1) twice = Mul (speed, again) shift = Mul (twice, half)",
    )
    return splitting_model.with_weights(parts=i64(_SPLIT_COUNT), half=f32(0.5))
