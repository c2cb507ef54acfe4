"""Validation rules of trajectory predictors: valid states, and the symmetries of motion."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.behaviour_probes import (
    HISTORIES,
    NEGATED_LABEL,
    PATH_OFFSET,
    STEADY_TURN_LABEL,
    STRAIGHT_PATH_LABEL,
)
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun, ProbeRuns
from gsgen.contract.spec.fields.roles import STATE_SIZES, TRAJECTORY
from gsgen.contract.spec.manifest import TrajectoryManifest
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, line_hint
from gsgen.contract.validation.gates import MODEL_RUNS, REPRODUCIBLE
from gsgen.contract.validation.rule import rule

_POSITION_COLUMNS = slice(0, 3)
_ROTATION = slice(3, None)
# The largest difference of a quaternion's length from 1.
_UNIT_QUATERNION_TOLERANCE = 1e-3
# A dot product of quaternions, or a length beyond π, may be off by this much.
_SIGN_SLACK = 1e-3
# A step that is a smaller share of the coordinates is lost in the rounding of a model's float32.
_MIN_STEP_RATIO = 2.0**-15
# On three straight paths that are orthogonal, the next cameras come as far as this share of the
# largest way in every direction, up left out where `space` tells it: 1 in right models, 0.9 in
# trained ones, 0.65 in one whose steps along x fall by 20 % each.
_MIN_ISOTROPY, _MIN_SPEED = 0.75, 0.2
# A negative eigenvalue of a covariance, relative to its largest one, that rounding explains.
_EIGENVALUE_SLACK = 1e-5
# The mean dot product of the newest state and the first prediction: above 0.9 in the right order of
# numbers, −0.3 to 0.5 in another.
_MIN_ORDER_MARGIN = 0.3
# The largest drift of a predicted state, relative to the size of the coordinates.
_MAX_REST_POSE_DRIFT = 2e-3
_DIVISION_HINT = (
    "A division by a speed, a length or a difference sees zero: add a small number to it."
)


@rule("GV060", Severity.ERROR, needs=(MODEL_RUNS, "GO019"), kinds=(TRAJECTORY,))
def prediction_finite(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Every predicted state and every uncertainty is finite, also for a camera at rest.

    Why:
        A prefetcher turns states into frustums. NaN makes every comparison false: it fetches
        nothing or everything, and says neither.

    Hint:
        A division by a speed, a length or a difference sees zero: add a small number to it.
    """
    manifest = probe_runs.subject.manifest
    doubts = [manifest.outputs.uncertainty.name] if isinstance(manifest, TrajectoryManifest) else []
    for name, value, label in _values(probe_runs):
        if not np.isfinite(value).all():
            row = int(np.flatnonzero(~np.isfinite(value).all(axis=1))[0])
            actual = f"row {row} is {value[row].tolist()!r:.80} at probe {label!r}"
            line = line_hint("rows = torch.where(rows.abs() < 3e38, rows, 1)")
            hint = f"{_DIVISION_HINT} Uncertain meanwhile: {line}" if name in doubts else ""
            yield Violation.at(f"output {name}", actual, "finite numbers", hint=hint)


@rule(
    "GV061",
    Severity.ERROR,
    needs=(MODEL_RUNS, "GO019", "GV060"),
    kinds=(TRAJECTORY,),
    at_moments=True,
)
def uncertainty_positive(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Every predicted standard deviation is above 0, or every covariance positive semi-definite.

    Why:
        A viewer may weigh predictions by it. Zero claims certainty, which no camera path
        allows, and a negative number is usually the logarithm of a variance.

    Hint:
        Return exp(log_variance / 2) or a softplus, plus a small floor; of a covariance Σ = L Lᵀ
        the upper triangle, row by row.
    """
    manifest = probe_runs.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    uncertainty_output = manifest.outputs.uncertainty
    for name, value, label in _values(probe_runs):
        if name != uncertainty_output.name:
            continue
        if uncertainty_output.semantics == "covariance-upper":
            size = STATE_SIZES[manifest.outputs.future.representation]
            fault = covariance_fault(value.astype(np.float64), size)
            if fault:
                actual = f"{fault} at probe {label!r}"
                expected = "variances above 0, and no negative eigenvalue"
                yield Violation.at(f"output {name}", actual, expected)
        elif not (value > 0).all():
            actual = f"{float(value.min()):.4g} at probe {label!r}"
            hint = line_hint("rows = torch.exp(rows / 2)") if (value < 0).mean() > 0.5 else ""
            hint = f"Of logarithms of variances: {hint}" if hint else ""
            yield Violation.at(f"output {name}", actual, "numbers above 0", hint=hint)


def covariance_fault(triangles: Float[np.ndarray, "k n"], size: int) -> str:
    """Return the fault of covariances that are given by upper triangles, row by row; empty if valid."""
    readings = {}
    for words, corner in (("upper", np.triu_indices), ("lower", np.tril_indices)):
        rows, columns = corner(size)
        matrices = np.zeros((len(triangles), size, size))
        matrices[:, rows, columns] = matrices[:, columns, rows] = triangles
        eigenvalues = np.linalg.eigvalsh(matrices)
        variances = np.diagonal(matrices, axis1=1, axis2=2)
        slack = _EIGENVALUE_SLACK * np.abs(eigenvalues).max(axis=1)
        readings[words] = eigenvalues[:, 0], variances.min(axis=1), slack
    lowest, variance, slack = readings["upper"]
    is_wrong = (variance <= 0) | (lowest < -slack)
    if not is_wrong.any():
        return ""
    row = int(is_wrong.argmax())
    fault = f"the covariance in row {row} has the eigenvalue {lowest[row]:.4g}"
    if variance[row] <= 0:
        fault = f"the covariance in row {row} has the variance {variance[row]:.4g}"
    lowest, variance, slack = readings["lower"]
    if ((variance > 0) & (lowest >= -slack)).all():
        fault += "; read as the lower triangle, row by row, all are positive"
    return fault


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
            line = "rows[:, 3:] = rows[:, 3:] / rows[:, 3:].norm(dim=1, keepdim=True).clamp(1e-8)"
            expected = f"1 ± {_UNIT_QUATERNION_TOLERANCE:g}"
            yield Violation.at(f"output {name}", actual, expected, hint=line_hint(line))


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
        Multiply the quaternions of the history by the sign of its last w, and the predicted ones by
        the same sign; or predict from relative rotations.
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
        A history has its oldest state first, predictions the nearest one. A model that reverses
        either, brakes, or mixes up axes, fetches tiles that the camera will not see.

    Hint:
        Take the history's last row as the newest state, and return the nearest prediction first.
        Add the newest state minus the one before it, per step; multiply rotations by the newest
        one times the inverse of the one before.
    """
    from gsgen.contract.rules.behaviour.steady_paths import (
        MAX_STEP_ERROR,
        UNDOING_LINES,
        fault_of_steady_path,
    )

    manifest = behaviour.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    future_name, space = manifest.outputs.future.name, manifest.space
    vertical = None if space is None else "xyz".index(space.up[1])
    runs = behaviour.trial_runs("paths")
    paths = [run for run in runs if STRAIGHT_PATH_LABEL in run.probe.label]
    turns = [run for run in runs if STEADY_TURN_LABEL in run.probe.label]
    turns += behaviour.trial_runs(HISTORIES)
    shares = _slowest_direction(behaviour, paths[:3])
    if shares is not None and shares[0] < _MIN_ISOTROPY:
        axis = " ".join(f"{part:.2g}" for part in shares[1])
        actual = (
            f"straight paths along ({axis}) go on by {shares[0]:.2g} of what others do: a path that "
            "is turned in space is predicted otherwise"
        )
        expected = "the same motion in every direction, but for that along `space.up`"
        hint = 'Treat x, y and z alike, or declare "space" with the "up" that the model knows.'
        yield Violation.at(f"output {future_name}", actual, expected, hint=hint)
        return
    for words, turning, group in (("moves", False, paths), ("turns", True, turns)):
        for run in group:
            history, future = _history(behaviour, run), _future_states(behaviour, run)
            if future is None or len(history) < 2 or future.shape[1] != history.shape[1]:
                continue
            if not (turning or _is_resolved(history)):
                continue
            fault = fault_of_steady_path(history, future, turning=turning, vertical=vertical)
            if fault:
                actual = f"a camera that {words} at constant speed: {fault} ({run.probe.label!r})"
                expected = (
                    f"the first state one step on, within {MAX_STEP_ERROR:g} of it; later ones go on "
                    "so, or brake gently"
                )
                line = line_hint(UNDOING_LINES.get(fault, ""))
                # The first state, one step before the oldest one: the newest was taken from there.
                if fault.startswith(f"predicted state 1 is -{len(history)} steps on"):
                    name = next(e.name for e in manifest.inputs if e.role == "camera_history")
                    line = line_hint(f"{name} = {name}.flip(0)", first=True)
                yield Violation.at(f"output {future_name}", actual, expected, hint=line)
                return


def _slowest_direction(
    behaviour: Behaviour, paths: list[ProbeRun]
) -> tuple[float, Float[np.ndarray, "3"]] | None:
    """Return the smallest way over the largest one of all directions, and its direction.

    The ways to each of the next predictions on three orthogonal paths make a matrix; its symmetric
    part is a multiple of the identity where all directions are alike. The prediction with the
    smallest share counts.
    """
    from gsgen.contract.rules.behaviour.steady_paths import NEXT_STATES

    manifest = behaviour.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    matrices = np.zeros((1, 3, 3))
    for run in paths:
        history, future = _history(behaviour, run), _future_states(behaviour, run)
        if future is None or len(history) < 2 or not _is_resolved(history):
            return None
        step = history[-1, _POSITION_COLUMNS] - history[-2, _POSITION_COLUMNS]
        ways = future[:NEXT_STATES, _POSITION_COLUMNS] - history[-1, _POSITION_COLUMNS]
        matrices = matrices + ways[:, :, None] * step / (step @ step)
    basis = np.eye(3)
    if manifest.space is not None:  # the vertical is an axis of its own
        basis = np.delete(basis, "xyz".index(manifest.space.up[1]), axis=0)
    symmetric = (matrices + matrices.transpose(0, 2, 1)) / 2
    ways, directions = np.linalg.eigh(basis @ symmetric @ basis.T)
    if len(paths) < 3 or ways[0, -1] < _MIN_SPEED:
        return None
    shares = ways[:, 0] / np.maximum(ways[:, -1], _MIN_SPEED)
    least = int(shares.argmin())
    return float(shares[least]), directions[least, :, 0] @ basis


def _is_resolved(history: Float[np.ndarray, "t s"]) -> bool:
    """Return whether a step of a path has many numbers of float32, at its distance from the origin."""
    step = np.linalg.norm(history[-1, _POSITION_COLUMNS] - history[-2, _POSITION_COLUMNS])
    return bool(step > _MIN_STEP_RATIO * np.abs(history[:, _POSITION_COLUMNS]).max())


def _history(behaviour: Behaviour, run: ProbeRun) -> Float[np.ndarray, "t s"]:
    manifest = behaviour.subject.manifest
    assert manifest is not None
    name = next(entry.name for entry in manifest.inputs if entry.role == "camera_history")
    return run.probe.inputs[name].astype(np.float64)


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
    from gsgen.contract.rules.behaviour.steady_paths import UNDOING_LINES, W_LAST

    manifest = probe_runs.subject.manifest
    assert isinstance(manifest, TrajectoryManifest)
    future = manifest.outputs.future
    history_name = next(entry.name for entry in manifest.inputs if entry.role == "camera_history")
    inputs = {probe.label: probe.inputs[history_name] for probe in probe_runs.plan.probes}
    paths = [
        (np.vstack([inputs[label][-1:, _ROTATION], value[:, _ROTATION]]).astype(np.float64), label)
        for name, value, label in _values(probe_runs, includes_zeros=False)
        if name == future.name
    ]
    for rotations, label in paths:
        if future.representation == "position+quaternion-wxyz":
            products = (rotations[:-1] * rotations[1:]).sum(axis=1)
            wrong, number, expected = products < -_SIGN_SLACK, products, "at least 0"
            words = "dot product {:.3g} with the state before"
            if _written_with_w_last([states for states, _ in paths]):
                words = f"{W_LAST}, not w x y z: {words}"
        else:
            number = np.linalg.norm(rotations[1:], axis=1)
            wrong, expected = number > np.pi + _SIGN_SLACK, "at most π"
            words = "length {:.4g}"
        if wrong.any():
            row = int(wrong.argmax())
            actual = f"{words.format(number[row])} in row {row} at probe {label!r}"
            hint = ""
            if words.startswith("dot product"):
                products_text = f"(rows[:, 3:] * {history_name}[-1:, 3:]).sum(1, keepdim=True)"
                hint = line_hint(f"rows[:, 3:] = rows[:, 3:] * {products_text}.sign()")
                hint = f"Give all quaternions the sign of the newest state's. {hint}"
            elif words.startswith(W_LAST):
                hint = line_hint(UNDOING_LINES[W_LAST])
            yield Violation.at(f"output {future.name}", actual, expected, hint=hint)
            return


def _written_with_w_last(paths: list[Float[np.ndarray, "k 4"]]) -> bool:
    """Return whether predictions continue the newest state only if read in the order x y z w."""
    first = np.stack([path[:2] for path in paths])
    as_written, w_last = (
        (first[:, 0] * first[:, 1][:, order]).sum(axis=1).mean()
        for order in ([0, 1, 2, 3], [3, 0, 1, 2])
    )
    return bool(w_last > max(as_written, 0) + _MIN_ORDER_MARGIN)


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
