"""Validation rules of effects: those of inputs are visible and smooth, and rows stay whole."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from gsgen.contract._array_types import Float, Int
from gsgen.contract.probing.drawn_sample import DrawnSample, draw_sample, spatial_groups
from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun
from gsgen.contract.spec.fields.roles import CAMERA_ROLES
from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.layout import COVARIANCE, CULL_OPACITY, OPACITY, POSITION
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.agreement import field_errors
from gsgen.contract.validation.finding import Statistic, Violation
from gsgen.contract.validation.gates import COLORED_ROW_RULES, REPRODUCIBLE, VALID_ROWS
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
        Compare the range and the unit of the input with those of training, and load its weights
        before the export. If the effect is meant to be that small, ignore this rule.
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
            yield Violation.at(f"role {role}", actual, "a visible effect", certainty="possible")


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


# Rows of which two runs hold the same numbers, at other places. Where they are sorted or selected,
# all fields move by the same places: 0 % of the rows differ in right models, 60 to 100 % where one
# field was left in its order.
_MIN_REORDERED_ROWS, _MIN_TORN_SHARE = 24, 0.1
# Numbers that many rows share say nothing of their places.
_MIN_KNOWN_SHARE = 0.3

# Colours that depend on the camera change a little from run to run. Of right models that sort rows,
# 0 to 10 % have a colour that is nearer to that of the row which took their place.
_MIN_NEARER_SHARE = 0.7

# The statistic is the share of patches whose sizes and distances change by factors that differ by
# this much. Patches count in which all distances change alike. Right models: 0; positions alone
# that are normalised, and sizes alone that pulse: 0.6 to 1.
_MIN_FACTOR_RATIO, _MAX_RIGHT_SHARE = 1.8, 0.3
_MAX_FACTOR_DEVIATION = 0.2
_GROUP_ROWS = 24

_TINY = 1e-30


@rule("GB065", Severity.ERROR, needs=(*REPRODUCIBLE, *VALID_ROWS, *COLORED_ROW_RULES))
def fields_move_together(behaviour: Behaviour) -> Iterator[Violation]:
    """Where rows come in another order, position, shape and appearance of a row move together.

    Why:
        A model may sort rows, or drop some and close the gaps. If one tensor is not gathered by the
        same indices as the others, Gaussians get the colours or the sizes of other ones.

    Hint:
        Gather positions, opacities, covariances and colours by the same indices.
    """
    subject = behaviour.subject
    for role in behaviour.comparisons_by_role:
        if not any(subject.inputs_of(role)):
            continue  # the key of a single input repeats that of its role
        is_camera = role in CAMERA_ROLES
        runs = behaviour.variants(role)
        outputs = [read_outputs(subject, probe.label, arrays) for probe, arrays in runs]
        for later in outputs[1:]:
            moves = _moves(outputs[0], later, has_positions=is_camera)
            torn = _torn_share(moves)
            if torn is None and is_camera:
                torn = _torn_colors(outputs[0], later, moves)
            if torn is None:
                continue
            (first, second), share, count = torn
            actual = (
                f"{second} stays behind {first} in {share:.0%} of {count} rows that come at other "
                f"places at {later.probe!r}"
            )
            yield Violation.at(
                f"role {role}",
                actual,
                "fields of a row that move together",
                certainty="confirmed"
                if is_camera or _are_whole_rows(outputs[0], later)
                else "possible",
                statistic=Statistic("share of torn rows", share, 0.0, _MIN_TORN_SHARE),
            )
            break


Moves = dict[str, Int[np.ndarray, " n"]]


def _moves(before: ModelOutputs, after: ModelOutputs, *, has_positions: bool) -> Moves:
    """Return for each field of a row the row of a later run that holds the same numbers.

    −1 stands for rows without one, or with several. Without ``has_positions``, positions move.
    """
    a, b = before.gaussians, after.gaussians
    if a is None or b is None or a.shape != b.shape:
        return {}
    fields = {"shape": (a[:, OPACITY:], b[:, OPACITY:])}
    if has_positions:
        fields = {
            "position": (a[:, POSITION], b[:, POSITION]),
            "opacity": (a[:, [OPACITY]], b[:, [OPACITY]]),
            "covariance": (a[:, COVARIANCE], b[:, COVARIANCE]),
        }
    if before.appearance is not None and after.appearance is not None:
        fields["appearance"] = (before.appearance, after.appearance)
    live = (before.count, after.count)
    if all(np.array_equal(x[: live[0]], y[: live[0]]) for x, y in fields.values()):
        return {}
    moves = {}
    for name, (x, y) in fields.items():
        move = _matched_rows(x[: live[0]], y[: live[1]])
        if (move >= 0).mean() >= _MIN_KNOWN_SHARE:
            moves[name] = move
    return moves


def _are_whole_rows(before: ModelOutputs, after: ModelOutputs) -> bool:
    """Return whether most Gaussians of a run come again in a later one, at other places.

    Where Gaussians move, their shapes alone come again: something else may have changed them.
    """
    a, b = before.gaussians, after.gaussians
    assert a is not None
    assert b is not None
    move = _matched_rows(a[: before.count], b[: after.count])
    is_known = move >= 0
    is_elsewhere = is_known & (move != np.arange(len(move)))
    return bool(is_known.mean() >= _MIN_KNOWN_SHARE and is_elsewhere.mean() >= _MIN_TORN_SHARE)


def _matched_rows(
    before: Float[np.ndarray, "n k"], after: Float[np.ndarray, "m k"]
) -> Int[np.ndarray, " n"]:
    """Return the index of the row of the second array with the same bits; −1 if not just one."""
    from gsgen.contract.probing.row_screen import row_keys

    keys, later_keys = row_keys(before), row_keys(after)
    distinct, first, counts = np.unique(later_keys, return_index=True, return_counts=True)
    if not len(distinct):
        return np.full(len(keys), -1)
    slots = np.minimum(np.searchsorted(distinct, keys), len(distinct) - 1)
    is_known = (distinct[slots] == keys) & (counts[slots] == 1)
    _, inverse, own_counts = np.unique(keys, return_inverse=True, return_counts=True)
    return np.where(is_known & (own_counts[inverse] == 1), first[slots], -1)


def _torn_share(moves: Moves) -> tuple[tuple[str, str], float, int] | None:
    """Return two fields that move to different places, for which share of how many rows."""
    names = list(moves)
    for index, first in enumerate(names):
        for second in names[index + 1 :]:
            a, b = moves[first], moves[second]
            places = np.arange(len(a))
            is_moved = (a >= 0) & (b >= 0) & ((a != places) | (b != places))
            count = int(np.count_nonzero(is_moved))
            if count < _MIN_REORDERED_ROWS:
                continue
            share = float((a[is_moved] != b[is_moved]).mean())
            if share >= _MIN_TORN_SHARE:
                return (first, second), share, count
    return None


def _torn_colors(
    before: ModelOutputs, after: ModelOutputs, moves: Moves
) -> tuple[tuple[str, str], float, int] | None:
    """Return in which share of moved rows colours, which may have changed, did not move along."""
    move = moves.get("position")
    colors, later_colors = before.appearance, after.appearance
    if move is None or colors is None or later_colors is None or "appearance" in moves:
        return None
    places = np.flatnonzero((move >= 0) & (move != np.arange(len(move))))
    places = places[places < after.count]
    if len(places) < _MIN_REORDERED_ROWS:
        return None
    own = colors[places].astype(np.float64)
    stayed = np.abs(own - later_colors[places]).sum(axis=1)
    moved = np.abs(own - later_colors[move[places]]).sum(axis=1)
    share = float((stayed < moved).mean())
    return (("position", "appearance"), share, len(places)) if share >= _MIN_NEARER_SHARE else None


@rule("GB066", Severity.WARNING, needs=(*REPRODUCIBLE, *VALID_ROWS))
def sizes_change_with_distances(behaviour: Behaviour) -> Iterator[Violation]:
    """Where neighbours move apart or together by a factor, their sizes change by that factor, too.

    Why:
        A scene that is scaled keeps its surfaces closed only if its Gaussians are scaled as well.
        Positions alone that are normalised in each frame tear holes, or pile Gaussians up; sizes
        alone that change blur the scene.

    Hint:
        Multiply covariances by s² where positions are multiplied by s. If parts are meant to
        scatter, or to grow and shrink, ignore this rule.
    """
    subject = behaviour.subject
    for role in behaviour.comparisons_by_role:
        if role in (*CAMERA_ROLES, "control") or not any(subject.inputs_of(role)):
            continue
        runs = behaviour.variants(role)
        outputs = [read_outputs(subject, probe.label, arrays) for probe, arrays in runs]
        sample = draw_sample(outputs[0]) if outputs else None
        for later in outputs[1:] if sample is not None else ():
            assert sample is not None
            share, factors = _share_of_other_factors(sample, later)
            if share > _MAX_RIGHT_SHARE:
                actual = (
                    f"in {share:.0%} of the patches distances between neighbours change by a factor "
                    f"of {factors[0]:.3g}, and sizes by {factors[1]:.3g}, at {later.probe!r}"
                )
                yield Violation.at(
                    f"role {role}",
                    actual,
                    "sizes that change as distances do",
                    certainty="possible",
                    statistic=Statistic("share of patches", share, 0.0, _MAX_RIGHT_SHARE),
                )
                break


def _share_of_other_factors(
    sample: DrawnSample, later: ModelOutputs
) -> tuple[float, tuple[float, float]]:
    """Return the share of patches in which sizes change by another factor than distances do.

    Also return the median factors of distances and sizes in these patches.
    """
    rows = later.gaussians
    assert sample.emission.gaussians is not None
    if rows is None or rows.shape != sample.emission.gaussians.shape:
        return 0.0, (1.0, 1.0)
    if later.count != sample.emission.count:
        return 0.0, (1.0, 1.0)  # rows behind a dropped one are those of other Gaussians
    later_rows = rows[sample.indices].astype(np.float64)
    distances = [
        _log_distances(packed, sample.inner_indices, sample.neighbours)
        for packed in (sample.rows, later_rows)
    ]
    sizes = [
        np.log(np.maximum(np.linalg.det(symmetric(packed[:, COVARIANCE])), _TINY**3)) / 6
        for packed in (sample.rows, later_rows)
    ]
    change = distances[1] - distances[0]
    growth = (sizes[1] - sizes[0])[sample.inner_indices]
    position = sample.rows[sample.inner_indices][:, POSITION]
    differing = []
    counted = 0
    for group in spatial_groups(position, _GROUP_ROWS):
        middle = float(np.median(change[group]))
        # Pairs of neighbours that go their own ways tell nothing of a scale.
        if float(np.median(np.abs(change[group] - middle))) > _MAX_FACTOR_DEVIATION:
            continue
        counted += 1
        factors = middle, float(np.median(growth[group]))
        if abs(factors[0] - factors[1]) > np.log(_MIN_FACTOR_RATIO):
            differing.append(factors)
    if not differing:
        return 0.0, (1.0, 1.0)
    medians = np.exp(np.median(differing, axis=0))
    return len(differing) / counted, (float(medians[0]), float(medians[1]))


def _log_distances(
    rows: Float[np.ndarray, "n 10"],
    inner_indices: Int[np.ndarray, " m"],
    neighbours: Int[np.ndarray, "m k"],
) -> Float[np.ndarray, "m k"]:
    position = rows[:, POSITION]
    offsets = position[neighbours] - position[inner_indices][:, None]
    return np.asarray(np.log(np.maximum(np.linalg.norm(offsets, axis=2), _TINY)))
