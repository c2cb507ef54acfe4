"""Validation rules of trajectory predictors: valid states, and the symmetries of motion."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.behaviour_probes import (
    HISTORIES,
    NEGATED_LABEL,
    PATH_OFFSET,
    STRAIGHT_PATH_LABEL,
    TURN_AXIS,
    TURN_STEP,
)
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun, ProbeRuns
from gsgen.contract.spec.fields.roles import STATE_SIZES, TRAJECTORY
from gsgen.contract.spec.geometry import quaternion_product
from gsgen.contract.spec.manifest import TrajectoryManifest
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import MODEL_RUNS, REPRODUCIBLE
from gsgen.contract.validation.rule import rule

_POSITION_COLUMNS = slice(0, 3)
_ROTATION = slice(3, None)
# The largest difference of a quaternion's length from 1.
_UNIT_QUATERNION_TOLERANCE = 1e-3
# A dot product of quaternions, or a length beyond π, may be off by this much.
_SIGN_SLACK = 1e-3
# The statistic is the mean motion from state to state, along three straight paths, in steps of the
# path. It is 1 where the motion goes on, 0.5 where it slows down, 0 where it stops, −0.2 to −2.9
# for a history that is read or written the other way round. The same holds for a camera that turns
# at constant speed.
_MAX_BACKWARD_STEPS = 0.1
# Off the path by more than this many steps, and by more than this multiple of the motion along
# it: axes that are exchanged or negated give 0.9 and 2 or more, right models at most 0.3 steps.
_MAX_SIDE_STEPS, _MAX_SIDE_RATIO = 0.5, 1.0
# More than so many steps at once: the speed is in another unit than steps.
_MAX_FORWARD_STEPS = 3.0
# On three straight paths that are orthogonal, motions go on by at least this share of the largest
# in every direction, up left out where `space` tells it: 1 in right models, 0.4 in one that damps y.
_MIN_ISOTROPY, _MIN_SPEED = 0.5, 0.2
# Motions equal step_seconds within this share where a motion per step is multiplied by seconds.
_MAX_SECONDS_ERROR, _MAX_STEP_SECONDS = 0.05, 0.25
# The largest drift of a predicted state, relative to the size of the coordinates.
_MAX_REST_POSE_DRIFT = 2e-3


@rule("GV060", Severity.ERROR, needs=(MODEL_RUNS, "GO019"), kinds=(TRAJECTORY,))
def prediction_finite(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Every predicted state and every uncertainty is finite, also for a camera at rest.

    Why:
        A prefetcher turns states into frustums. NaN makes every comparison false: it fetches
        nothing or everything, and says neither.

    Hint:
        A division by a speed, a length or a difference sees zero: add a small number to it.
    """
    for name, value, label in _values(probe_runs):
        if not np.isfinite(value).all():
            row = int(np.flatnonzero(~np.isfinite(value).all(axis=1))[0])
            actual = f"row {row} is {value[row].tolist()!r:.80} at probe {label!r}"
            yield Violation.at(f"output {name}", actual, "finite numbers")


@rule(
    "GV061",
    Severity.ERROR,
    needs=(MODEL_RUNS, "GO019", "GV060"),
    kinds=(TRAJECTORY,),
    at_moments=True,
)
def uncertainty_positive(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Every predicted standard deviation, or every variance on the diagonal, is above 0.

    Why:
        A viewer may weigh predictions by it. Zero claims certainty, which no camera path
        allows, and a negative number is usually the logarithm of a variance.

    Hint:
        Return exp(log_variance / 2) or a softplus, plus a small floor.
    """
    manifest = probe_runs.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    uncertainty_output = manifest.outputs.uncertainty
    for name, value, label in _values(probe_runs):
        if name != uncertainty_output.name:
            continue
        if uncertainty_output.semantics == "covariance-upper":
            size = STATE_SIZES[manifest.outputs.future.representation]
            rows = np.arange(size)
            value = value[:, rows * size - rows * (rows - 1) // 2]
        if not (value > 0).all():
            actual = f"{float(value.min()):.4g} at probe {label!r}"
            yield Violation.at(f"output {name}", actual, "numbers above 0")


@rule(
    "GV062",
    Severity.ERROR,
    needs=(MODEL_RUNS, "GO019", "GV060"),
    kinds=(TRAJECTORY,),
    at_moments=True,
)
def predicted_quaternions_unit(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Predicted quaternions have length 1.

    Why:
        A reader that does not normalise them scales its frustum with the length; lengths far
        from 1 show that the model interpolates numbers in place of rotations.

    Hint:
        Divide by the length at the end of the model; add a small number to it for zeros.
    """
    manifest = probe_runs.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    if manifest.outputs.future.representation != "position+quaternion-wxyz":
        return
    for name, value, label in _values(probe_runs, includes_zeros=False):
        if name != manifest.outputs.future.name:
            continue
        length = np.linalg.norm(value[:, _ROTATION].astype(np.float64), axis=1)
        if not (np.abs(length - 1) <= _UNIT_QUATERNION_TOLERANCE).all():
            row = int(np.abs(length - 1).argmax())
            actual = f"length {length[row]:.4g} in row {row} at probe {label!r}"
            yield Violation.at(f"output {name}", actual, f"1 ± {_UNIT_QUATERNION_TOLERANCE:g}")


def _values(
    probe_runs: ProbeRuns, *, includes_zeros: bool = True
) -> Iterator[tuple[str, np.ndarray, str]]:
    """Yield output name, array and test input label of both outputs of a trajectory predictor."""
    manifest = probe_runs.subject.manifest
    if not isinstance(manifest, TrajectoryManifest):
        return
    names = (manifest.outputs.future.name, manifest.outputs.uncertainty.name)
    for run, probe in zip(
        probe_runs.execution.runs[: probe_runs.plan.values], probe_runs.plan.probes, strict=False
    ):
        outputs = probe_runs.execution.samples[run.sample].outputs if run.sample >= 0 else {}
        for name in names:
            value = outputs.get(name)
            if value is not None and value.ndim == 2 and (includes_zeros or not probe.zeros):
                yield name, value, probe.label


@rule("GB050", Severity.ERROR, needs=(*REPRODUCIBLE, "GO019", "GV060"), kinds=(TRAJECTORY,))
def prediction_moves_along(behaviour: Behaviour) -> Iterator[Violation]:
    """Moving all past cameras by an offset moves all predicted cameras by the same offset.

    Why:
        A world has no special place. A model that learned where people stood in one scene
        predicts that place in every other one.

    Hint:
        Subtract the last position from the history inside the model, and add it to the result.
    """
    runs = behaviour.trial_runs("paths")
    if len(runs) < 2:
        return
    expected = _future_states(behaviour, runs[0])
    actual = _future_states(behaviour, runs[1])
    if expected is None or actual is None:
        return
    expected = expected.copy()
    expected[:, _POSITION_COLUMNS] += PATH_OFFSET
    yield from _compare(behaviour, actual, expected, f"a history moved by {list(PATH_OFFSET)}")


@rule("GB051", Severity.ERROR, needs=(*REPRODUCIBLE, "GO019", "GV060"), kinds=(TRAJECTORY,))
def rest_stays_at_rest(behaviour: Behaviour) -> Iterator[Violation]:
    """A camera that has not moved in the past is predicted to stay at rest.

    Why:
        Most of the time viewers look around or stand still. A drift fetches tiles that are
        never seen, over and over.

    Hint:
        Predict from differences of states, without a bias in the last layer.
    """
    runs = behaviour.trial_runs("paths")
    manifest = behaviour.subject.manifest
    if len(runs) < 3 or not isinstance(manifest, TrajectoryManifest):
        return
    name = next(entry.name for entry in manifest.inputs if entry.role == "camera_history")
    actual = _future_states(behaviour, runs[2])
    if actual is not None:
        state = runs[2].probe.inputs[name][-1].astype(np.float64)
        yield from _compare(behaviour, actual, np.tile(state, (len(actual), 1)), "a camera at rest")


@rule("GB052", Severity.ERROR, needs=(*REPRODUCIBLE, "GO019", "GV060"), kinds=(TRAJECTORY,))
def quaternion_sign_ignored(behaviour: Behaviour) -> Iterator[Violation]:
    """Quaternions q and −q in the camera history give the same prediction.

    Why:
        Both are the same rotation, and trackers, engines and files give either. A model that
        tells them apart predicts another path after a change of sign that means nothing.

    Hint:
        Multiply the history by the sign of its last w, or predict from relative rotations.
    """
    runs = behaviour.trial_runs("paths")
    if len(runs) < 2 or not runs[-1].probe.label.endswith(NEGATED_LABEL):
        return
    expected, actual = (_future_states(behaviour, runs[index]) for index in (0, -1))
    if expected is not None and actual is not None:
        yield from _compare(behaviour, actual, expected, "a history with quaternions negated")


@rule(
    "GB062",
    Severity.ERROR,
    needs=(*REPRODUCIBLE, "GO019", "GV060", "GB050", "GB051"),
    kinds=(TRAJECTORY,),
)
def straight_path_goes_on(behaviour: Behaviour) -> Iterator[Violation]:
    """Where the camera moves or turns at constant speed, predictions go on so in all directions.

    Why:
        The history has its oldest state first, and predictions the nearest one. A model that
        reverses either, or mixes up axes, fetches the scene behind the camera.
        One that slows down along y alone knows an axis that other worlds lack.

    Hint:
        Take the last row of the history as the newest state, and return the nearest prediction
        first; `flip(0)` reverses rows. Add the newest state minus the one before it, per step.
    """
    manifest = behaviour.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    paths = [run for run in behaviour.trial_runs("paths") if STRAIGHT_PATH_LABEL in run.probe.label]
    kinds = {
        "straight paths": [_straight_motions(behaviour, run) for run in paths],
        "turns": [_turning_motions(behaviour, run) for run in behaviour.trial_runs(HISTORIES)],
    }
    for words, motions in kinds.items():
        known_motions = [motion for motion in motions if motion is not None]
        mean_motion = np.mean(known_motions, axis=0) if known_motions else None
        fault = (
            _fault_of_motion(mean_motion, manifest.step_seconds) if mean_motion is not None else ""
        )
        if fault:
            expected = "steps along the path, as those of the history"
            actual = f"on {words}, {fault}"
            yield Violation.at(f"output {manifest.outputs.future.name}", actual, expected)
            return
    shares = _slowest_direction(behaviour, paths)
    if shares is not None and shares[0] < _MIN_ISOTROPY:
        axis = " ".join(f"{part:.2g}" for part in shares[1])
        actual = (
            f"straight paths along ({axis}) go on by {shares[0]:.2g} of what others do: a path that "
            "is turned in space is predicted otherwise"
        )
        expected = "the same motion in every direction, but for that along `space.up`"
        hint = 'Treat x, y and z alike, or declare "space" with the "up" that the model knows.'
        yield Violation.at(f"output {manifest.outputs.future.name}", actual, expected, hint=hint)


def _slowest_direction(
    behaviour: Behaviour, paths: list[ProbeRun]
) -> tuple[float, Float[np.ndarray, "3"]] | None:
    """Return the smallest motion over the largest one of all directions, and its direction.

    The motions to the first prediction on three orthogonal paths make a matrix; its symmetric part
    is a multiple of the identity where all directions are alike.
    """
    manifest = behaviour.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    matrix = np.zeros((3, 3))
    for run in paths:
        history, future = _history(behaviour, run), _future_states(behaviour, run)
        if future is None or len(history) < 2:
            return None
        step = history[-1, _POSITION_COLUMNS] - history[-2, _POSITION_COLUMNS]
        motion = future[0, _POSITION_COLUMNS] - history[-1, _POSITION_COLUMNS]
        matrix += np.outer(motion, step) / (step @ step)
    basis = np.eye(3)
    if manifest.space is not None:  # the vertical is an axis of its own
        basis = np.delete(basis, "xyz".index(manifest.space.up[1]), axis=0)
    speeds, directions = np.linalg.eigh(basis @ (matrix + matrix.T) @ basis.T / 2)
    if len(paths) < 3 or speeds[-1] < _MIN_SPEED:
        return None
    return float(speeds[0] / speeds[-1]), directions[:, 0] @ basis


def _fault_of_motion(motions: Float[np.ndarray, "k 2"], step_seconds: float) -> str:
    """Return the fault of predicted motions on a steady path; empty if they have none.

    Args:
        motions: Steps along the path and off it, from the newest state to the first prediction,
            and from each prediction to the next.
        step_seconds: The seconds from state to state.
    """
    along = motions[:, 0]
    is_times_seconds = np.abs(along - step_seconds).max() <= _MAX_SECONDS_ERROR * step_seconds
    if step_seconds <= _MAX_STEP_SECONDS and is_times_seconds:
        return f"each state lies {step_seconds:g} steps ahead: a motion per step times step_seconds"
    for number, (forward, sideways) in enumerate(motions, start=1):
        start = "the state before" if number > 1 else "the newest of the history"
        if forward < -_MAX_BACKWARD_STEPS:
            return f"predicted state {number} lies {-forward:.2g} steps behind {start}"
        if sideways > max(_MAX_SIDE_STEPS, _MAX_SIDE_RATIO * forward):
            return f"predicted state {number} lies {sideways:.2g} steps aside of {start}"
        if forward > _MAX_FORWARD_STEPS:
            return f"predicted state {number} lies {forward:.3g} steps ahead of {start}"
    return ""


def _steps_along(
    motions: Float[np.ndarray, "k 3"], step: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "k 2"]:
    """Return the parts of motions along a step and across it, in lengths of the step."""
    length = float(np.linalg.norm(step))
    along = motions @ step / length**2
    across = np.linalg.norm(motions - along[:, None] * step, axis=1) / length
    return np.stack([along, across], axis=1)


def _history(behaviour: Behaviour, run: ProbeRun) -> Float[np.ndarray, "t s"]:
    manifest = behaviour.subject.manifest
    assert manifest is not None
    name = next(entry.name for entry in manifest.inputs if entry.role == "camera_history")
    return run.probe.inputs[name].astype(np.float64)


def _straight_motions(behaviour: Behaviour, run: ProbeRun) -> Float[np.ndarray, "k 2"] | None:
    """Return how predicted cameras move on a straight path, in its steps; None without a speed."""
    future, history = _future_states(behaviour, run), _history(behaviour, run)
    if future is None or len(history) < 2:
        return None
    states = np.vstack([history[-1:], future])[:, _POSITION_COLUMNS]
    return _steps_along(
        np.diff(states, axis=0), np.diff(history[-2:, _POSITION_COLUMNS], axis=0)[0]
    )


def _turning_motions(behaviour: Behaviour, run: ProbeRun) -> Float[np.ndarray, "k 2"] | None:
    """Return how predicted cameras turn after a steady turn, in its steps; None without a speed."""
    future, history = _future_states(behaviour, run), _history(behaviour, run)
    if future is None or len(history) < 2:
        return None
    states = np.vstack([history[-1:], future])[:, _ROTATION]
    turns = [
        _rotation_vector(quaternion_product(later, earlier * [1, -1, -1, -1]))
        for earlier, later in pairwise(states)
    ]
    return _steps_along(np.stack(turns), TURN_STEP * np.asarray(TURN_AXIS))


def _rotation_vector(quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " 3"]:
    """Return axis times angle, in radians, of a quaternion (w, x, y, z) of either sign."""
    w, vector = np.abs(quaternion[0]), quaternion[1:] * (1 if quaternion[0] >= 0 else -1)
    sine = float(np.linalg.norm(vector))
    return np.asarray(2 * np.arctan2(sine, w) / max(sine, 1e-12) * vector)


@rule(
    "GV064",
    Severity.ERROR,
    needs=(MODEL_RUNS, "GO019", "GV060", "GV062"),
    kinds=(TRAJECTORY,),
    at_moments=True,
)
def predicted_rotations_continue(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Each predicted quaternion continues the sign of the state before it; axis-angles end at π.

    Why:
        A reader interpolates between states. From q to −q it turns by a whole circle within one
        step, and fetches all sides.

    Hint:
        Multiply each predicted quaternion by the sign of its dot product with the state before it,
        the first one with the newest state of the history.
    """
    manifest = probe_runs.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    future = manifest.outputs.future
    history_name = next(entry.name for entry in manifest.inputs if entry.role == "camera_history")
    inputs = {probe.label: probe.inputs[history_name] for probe in probe_runs.plan.probes}
    for name, value, label in _values(probe_runs, includes_zeros=False):
        if name != future.name:
            continue
        rotations = np.vstack([inputs[label][-1:, _ROTATION], value[:, _ROTATION]])
        rotations = rotations.astype(np.float64)
        if future.representation == "position+quaternion-wxyz":
            products = (rotations[:-1] * rotations[1:]).sum(axis=1)
            wrong, number, expected = products < -_SIGN_SLACK, products, "at least 0"
            words = "dot product {:.3g} with the state before"
        else:
            number = np.linalg.norm(value[:, _ROTATION].astype(np.float64), axis=1)
            wrong, expected = number > np.pi + _SIGN_SLACK, "at most π"
            words = "length {:.4g}"
        if wrong.any():
            row = int(wrong.argmax())
            actual = f"{words.format(number[row])} in row {row} at probe {label!r}"
            yield Violation.at(f"output {name}", actual, expected)
            return


def _future_states(behaviour: Behaviour, run: ProbeRun) -> np.ndarray | None:
    """Return the predicted camera states of a run in float64; None if they are not finite."""
    manifest = behaviour.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    value = run.outputs.get(manifest.outputs.future.name)
    if value is None or value.ndim != 2 or not np.isfinite(value).all():
        return None
    return value.astype(np.float64)


def _compare(
    behaviour: Behaviour, actual: np.ndarray, expected: np.ndarray, situation_text: str
) -> Iterator[Violation]:
    """Yield a violation if predicted states differ from the expected ones beyond rounding.

    Quaternions q and −q count as equal.
    """
    manifest = behaviour.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    future = manifest.outputs.future
    if actual.shape != expected.shape:
        return
    if future.representation == "position+quaternion-wxyz":
        products = (actual[:, _ROTATION] * expected[:, _ROTATION]).sum(axis=1)
        actual = actual.copy()
        actual[products < 0, _ROTATION] *= -1
    scale = max(1.0, float(np.abs(expected).max(initial=0)))
    difference = np.abs(actual - expected)
    if not (difference <= _MAX_REST_POSE_DRIFT * scale).all():
        row, column = np.unravel_index(int(difference.argmax()), difference.shape)
        yield Violation.at(
            f"output {future.name}",
            f"row {row} is off by {difference[row, column]:.4g} in column {column} for {situation_text}",
            f"a difference of {_MAX_REST_POSE_DRIFT * scale:.2g} at most",
        )
