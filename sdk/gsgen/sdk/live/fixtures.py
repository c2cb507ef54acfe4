"""Example models that break a rule of level ``live``, and show nothing wrong before.

They stand beside the corpus of :mod:`gsgen.conformance.fixtures`, whose models need no GPU.
"""

__all__ = ["live_fixtures"]

import sys

import numpy as np

from gsgen.conformance.fixtures import Fixture
from gsgen.conformance.fixtures.builders.arrays import f32, i64
from gsgen.conformance.fixtures.builders.fixture import fixtures_in, invalid
from gsgen.conformance.fixtures.builders.moving import drifting
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.severity import Level

_SHIFT = "shift = Mul (speed, time)"
_END = "gaussians = Concat <axis = 1> (moved, opacity, spread)"
# More results than any adapter's default number of storage buffers a stage.
_PARTS = 64


def live_fixtures() -> list[Fixture]:
    """Return the models, one a rule."""
    return fixtures_in(sys.modules[__name__])


@invalid("GB011", level=Level.LIVE)
def integers_of_64_bits() -> ModelSpec:
    """A number above 2³² comes and goes; the GPU keeps its lower half."""
    counted = drifting().reworded(
        _SHIFT,
        "scaled = Mul (time, thousand) whole = Cast <to = 7> (scaled) far = Add (whole, big) "
        "back = Cast <to = 1> (far) near = Div (back, size) shift = Mul (speed, near)",
    )
    big = np.asarray([1 << 32], np.int64)
    return counted.weighing(thousand=f32(1000), size=f32(1 << 32), big=big)


@invalid("GB014", level=Level.LIVE)
def branches_by_if() -> ModelSpec:
    """An If whose branches differ; a rule of the graph warns of it, too."""
    branched = drifting().reworded(
        _SHIFT,
        "late = Greater (time, half) turned = If (late) <then_branch = t () => (float[1] a) { a = Neg (time) }, "
        "else_branch = e () => (float[1] b) { b = Abs (time) }> "
        "shift = Mul (speed, turned)",
    )
    return branched.weighing(half=f32(0.5))


@invalid("GB015", level=Level.LIVE)
def round_on_the_cpu() -> ModelSpec:
    """Time is rounded to tenths by an operator that no GPU kernel exists for."""
    stepped = drifting().reworded(
        _SHIFT,
        "scaled = Mul (time, ten) whole = Round (scaled) step = Div (whole, ten) "
        "shift = Mul (speed, step)",
    )
    return stepped.weighing(ten=f32(10))


@invalid("GB016", level=Level.LIVE)
def output_from_idle_sum() -> ModelSpec:
    """Rows are made by a ReduceSum over no axis, a mere copy; a rule of the graph warns of it, too."""
    return drifting().reworded(
        _END,
        "packed = Concat <axis = 1> (moved, opacity, spread) "
        "gaussians = ReduceSum <noop_with_empty_axes = 1> (packed)",
    )


@invalid("GB017", level=Level.LIVE)
def split_into_many() -> ModelSpec:
    """A Split has more results than a kernel may bind; that shows only when it is launched."""
    parts = ", ".join(f"part_{index}" for index in range(_PARTS))
    wide = drifting().reworded(
        _SHIFT,
        f"many = Expand (time, parts) {parts} = Split <axis = 0, num_outputs = {_PARTS}> (many) "
        "again = Add (part_0, part_1) twice = Mul (speed, again) shift = Mul (twice, half)",
    )
    return wide.weighing(parts=i64(_PARTS), half=f32(0.5))
