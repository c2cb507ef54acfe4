"""Validation rules of effects: inputs whose effect is invisible, erratic, or only at range ends."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun
from gsgen.contract.spec.fields.roles import CAMERA_ROLES
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, POSITION
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.agreement import field_errors
from gsgen.contract.validation.finding import Statistic, Violation
from gsgen.contract.validation.gates import REPRODUCIBLE
from gsgen.contract.validation.report import Tolerance
from gsgen.contract.validation.rule import rule
from gsgen.contract.validation.tolerances import effective_tolerances

_SERIES_ROLES = ("time", "frame_index")
# Instants within the range that must differ from each other, of at least this many.
_MIN_INSTANT_COUNT = 3
# The statistic is the largest of three motions within a hundredth of the range, over the largest
# motion in it: 0.03 of one swing in the range, 0.2 of seven, and up to 1 of fifty. A single motion
# may be a cut from one scene to the next, so another one must reach a part of it.
_MAX_FIRST_STEP, _MAX_SECOND_STEP = 0.45, 0.15
# Fewer drawn rows say nothing of the motion of a scene.
_MIN_MOVED_ROWS = 16
_NEAR_FRACTIONS = (0.005, 0.02)


@rule("GB032", Severity.WARNING, needs=(*REPRODUCIBLE, "GB003", "GI006", "GO001", "GO002"))
def effect_is_visible(behaviour: Behaviour) -> Iterator[Violation]:
    """Each input that changes an output changes visible Gaussians by a visible amount.

    Why:
        An effect below the tolerances is rounding: the network behind it was not trained, its
        weights were not loaded, or the input is in another unit than it expects. Rows without
        opacity may move as they like.

    Hint:
        Compare the range and the unit of the input with those of training. If the effect is meant
        to be that small, set "depends_on": {role: false}.
    """
    subject, tolerances = behaviour.subject, effective_tolerances(behaviour.subject)
    for role in behaviour.comparisons_by_role:
        indices = behaviour.trial.plan.variants.get(role, (0, ()))[1]
        has_input_changed_output = any(
            comparison.changed for comparison in behaviour.comparisons_by_role[role]
        )
        entries = [entry for entry, _ in subject.inputs_of(role)]  # none of a single input's key
        depends = subject.generator is not None and any(map(subject.generator.depends, entries))
        if role in CAMERA_ROLES or not has_input_changed_output or not depends:
            continue
        base = _run_outputs(behaviour, behaviour.base)
        variants = [_run_outputs(behaviour, run) for run in behaviour.runs(indices)]
        if not any(_do_outputs_differ(base, variant, tolerances) for variant in variants):
            actual = f"its {len(variants)} variations change nothing beyond the tolerances"
            expected = "a visible effect, or depends_on false"
            yield Violation.at(f"role {role}", actual, expected, certainty="possible")


@rule("GB033", Severity.WARNING, needs=(*REPRODUCIBLE, "GB003", "GI006", "GM010", "GB032"))
def effect_throughout_range(behaviour: Behaviour) -> Iterator[Violation]:
    """Time changes the picture within its declared range, not only at the ends.

    Why:
        A model that takes whole frames shows its first frame for all of the range 0 to 1: only the
        end differs.

    Hint:
        Declare the range that the model takes, or multiply time by the number of frames inside it.
        If nothing happens before the end, ignore this rule.
    """
    tolerances = effective_tolerances(behaviour.subject)
    for entry, series in _iterate_series(behaviour):
        assert entry.range is not None
        low, high = entry.range
        inner_outputs = [outputs for value, outputs in series if low < value < high]
        ends = [outputs for value, outputs in series if value in (low, high)]
        if len(inner_outputs) < _MIN_INSTANT_COUNT or not ends:
            continue
        is_motion_free = not any(
            _do_outputs_differ(inner_outputs[0], outputs, tolerances)
            for outputs in inner_outputs[1:]
        )
        if is_motion_free and any(
            _do_outputs_differ(inner_outputs[0], outputs, tolerances) for outputs in ends
        ):
            actual = f"{len(inner_outputs)} instants within {low:g} to {high:g} are the same; only an end differs"
            expected = "change throughout the range"
            yield Violation.at(f"input {entry.name}", actual, expected, certainty="possible")


@rule("GB034", Severity.WARNING, needs=(*REPRODUCIBLE, "GB003", "GI006", "GM010"))
def motion_is_smooth(behaviour: Behaviour) -> Iterator[Violation]:
    """A hundredth of a time range from 0 to 1 moves Gaussians less than the whole range does.

    Why:
        Where it moves them as far, the scene swings back and forth tens of times, and no frame
        continues the one before: degrees were taken for radians, or seconds for a fraction.

    Hint:
        Check the unit of time, declare the range in seconds, or declare frames and fps. If the
        scene trembles by design, ignore this rule.
    """
    for entry, series in _iterate_series(behaviour):
        assert entry.range is not None
        span = entry.range[1] - entry.range[0]
        if entry.role != "time" or entry.frames or span > 1 or not _is_aligned(series):
            continue
        pairs = [(b - a, _mean_motion(x, y)) for (a, x), (b, y) in pairwise(series)]
        steps = [
            motion
            for value_gap, motion in pairs
            if _NEAR_FRACTIONS[0] * span < value_gap < _NEAR_FRACTIONS[1] * span
        ]
        motion_from_start = (_mean_motion(series[0][1], outputs) for _, outputs in series[1:])
        largest = max([*(motion for _, motion in pairs), *motion_from_start], default=0.0)
        second, first = sorted([0.0, 0.0, *steps])[-2:]
        if first > _MAX_FIRST_STEP * largest and second > _MAX_SECOND_STEP * largest:
            share = first / largest
            actual = (
                f"a hundredth of the range moves Gaussians by {share:.0%} of the largest motion"
            )
            expected = f"{_MAX_FIRST_STEP:.0%} at most, as smooth motion has"
            where, usual_statistic = (
                f"input {entry.name}",
                Statistic("share of motion", share, 0.0, _MAX_FIRST_STEP),
            )
            yield Violation.at(
                where, actual, expected, certainty="possible", statistic=usual_statistic
            )


OutputSeries = list[tuple[float, ModelOutputs]]


def _iterate_series(behaviour: Behaviour) -> Iterator[tuple[Input, OutputSeries]]:
    """Yield each time or frame input with the outputs of the runs that vary only that input."""
    generator = behaviour.subject.generator
    behaviour.trial_runs("swept")  # a rule whose probes did not run is skipped
    for entry in generator.inputs if generator else ():
        if entry.role in _SERIES_ROLES and entry.range is not None:
            yield entry, _input_series(behaviour, entry)


def _is_aligned(series: OutputSeries) -> bool:
    """Return whether all runs have the same row count, so that a row is the same Gaussian in each.

    Where rows are dropped or added, those behind them move up or down in the output.
    """
    return len({outputs.count for _, outputs in series}) <= 1


def _input_series(behaviour: Behaviour, entry: Input) -> OutputSeries:
    assert entry.range is not None
    low, high = entry.range
    base = behaviour.base.probe.inputs
    other_names = [name for name in base if name != entry.name]
    outputs_by_value: dict[float, ModelOutputs] = {}
    for run in behaviour.runs(range(len(behaviour.trial.execution.runs))):
        inputs = run.probe.inputs
        value = float(inputs[entry.name].reshape(-1)[0])
        are_other_inputs_same = all(
            np.array_equal(inputs[name], base[name]) for name in other_names
        )
        are_other_inputs_same &= low <= value <= high
        if (
            are_other_inputs_same
            and run.digest
            and run.probe.optimise
            and value not in outputs_by_value
        ):
            outputs_by_value[value] = _run_outputs(behaviour, run)
    return sorted(outputs_by_value.items(), key=lambda item: item[0])


def _run_outputs(behaviour: Behaviour, run: ProbeRun) -> ModelOutputs:
    return read_outputs(behaviour.subject, run.probe.label, run.outputs)


def _do_outputs_differ(a: ModelOutputs, b: ModelOutputs, tolerances: tuple[Tolerance, ...]) -> bool:
    """Return whether two model runs differ in visible Gaussians, beyond the tolerances."""
    same_count = a.count == b.count
    return not same_count or next(field_errors(a, b, tolerances), None) is not None


def _mean_motion(a: ModelOutputs, b: ModelOutputs) -> float:
    """Return the root mean square motion of visible Gaussians between two model runs."""
    x, y = a.gaussians, b.gaussians
    if x is None or y is None or x.shape != y.shape:
        return 0.0
    drawn = np.minimum(x[:, OPACITY], y[:, OPACITY]) >= CULL_OPACITY
    offset = x[drawn, POSITION].astype(np.float64) - y[drawn, POSITION]
    has_enough_rows = len(offset) >= _MIN_MOVED_ROWS
    return float(np.sqrt(np.square(offset).sum(axis=1).mean())) if has_enough_rows else 0.0
