"""Validation rules of root motion: translations are added, rotations turn all about the root."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.behaviour_probes import JOINTS, ROOT_LABEL
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.run_comparison import Behaviour
from gsgen.contract.spec.layout import COVARIANCE, CULL_OPACITY, OPACITY, POSITION
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, line_hint
from gsgen.contract.validation.gates import REPRODUCIBLE
from gsgen.contract.validation.rule import rule

_MIN_ROWS = 4
# All rows move alike if they differ by less than this fraction, and as told within the second.
_MAX_RIGID_ERROR = 5e-3
_MAX_VALUE_ERROR = 0.02
# Distances of rotations, as the Frobenius norm of their difference.
_MAX_SAME_ROTATION, _MIN_OTHER_ROTATION = 0.02, 0.2
# The root moves by at most this share of the body's size when the body turns: 0.000 in right
# models, 0.28 where a person turns about the feet.
_MAX_ROOT_MOTION = 0.05
# A covariance is wrong by more than the first share of the change that it should have made in at
# most the second share of the rows: 0 in right models, 1 in wrong ones.
_MAX_COVARIANCE_ERROR, _MAX_WRONG_SHARE = 0.3, 0.1

_RunPair = tuple[Probe, Probe, Float[np.ndarray, "n 10"], Float[np.ndarray, "n 10"]]


def _pairs(behaviour: Behaviour, role: str) -> Iterator[_RunPair]:
    """Yield pairs of model runs that differ in one input, and the rows that are drawn in both."""
    declared = behaviour.subject.declared_gaussians
    runs = behaviour.variants(role)
    if declared is None or len(behaviour.subject.inputs_of(role)) != 1 or len(runs) < 2:
        return
    base, first = runs[0][0], np.asarray(runs[0][1][declared.name], np.float64)
    for probe, outputs in runs[1:]:
        second = np.asarray(outputs[declared.name], np.float64)
        rows = _rows_drawn_in_both(first, second)
        if rows is not None:
            yield base, probe, *rows


def _rows_drawn_in_both(
    first: Float[np.ndarray, "n 10"], second: Float[np.ndarray, "n 10"]
) -> tuple[Float[np.ndarray, "m 10"], Float[np.ndarray, "m 10"]] | None:
    if first.shape != second.shape:
        return None
    drawn = (first[:, OPACITY] >= CULL_OPACITY) & (second[:, OPACITY] >= CULL_OPACITY)
    drawn &= np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    return (first[drawn], second[drawn]) if np.count_nonzero(drawn) >= _MIN_ROWS else None


@rule("GB041", Severity.ERROR, needs=(*REPRODUCIBLE, "GO001", "GO002", "GO016"))
def root_translation_added(behaviour: Behaviour) -> Iterator[Violation]:
    """A root translation that moves all Gaussians alike moves them by its value, in local units.

    Why:
        It is added to the body after posing and rotating. A model that adds it before the rotation
        walks in another direction than it looks; one in centimetres hardly moves.

    Hint:
        Add the translation to the centres last, in the unit of the positions.
    """
    for base, probe, first, second in _pairs(behaviour, "root_translation"):
        name = behaviour.subject.inputs_of("root_translation")[0][0].name
        translation = (probe.inputs[name] - base.inputs[name]).astype(np.float64)
        row_motion = second[:, POSITION] - first[:, POSITION]
        mean_motion, length = row_motion.mean(axis=0), float(np.linalg.norm(translation))
        is_uniform = np.abs(row_motion - mean_motion).max() <= _MAX_RIGID_ERROR * max(
            length, float(np.abs(mean_motion).max())
        )
        if (
            is_uniform
            and length > 0
            and np.linalg.norm(mean_motion - translation) > _MAX_VALUE_ERROR * length
        ):
            factor = float(np.linalg.norm(mean_motion)) / length
            actual = f"a translation by {_vector_text(translation)} moves all rows by {_vector_text(mean_motion)}"
            cause = (
                "the translation is rotated, so it is added before the rotation"
                if abs(factor - 1) <= _MAX_VALUE_ERROR
                else f"a factor of {factor:.3g}: another unit"
            )
            expected = f"the translation itself, added last; {cause}"
            is_scaled = (
                np.abs(mean_motion - factor * translation).max() <= _MAX_VALUE_ERROR * length
            )
            line = f"{name} = {name} / {factor:.4g}" if is_scaled and factor > 0 else ""
            hint = (
                f"Add the translation last, in the unit of the positions. {line_hint(line, first=True)}"
                if line
                else ""
            )
            yield Violation.at(f"input {name}", actual, expected, hint=hint)
            return


def _vector_text(vector: Float[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{value:.3g}' for value in vector)})"


@rule("GB042", Severity.ERROR, needs=(*REPRODUCIBLE, "GO001", "GO002", "GO016", "GI015"))
def root_rotation_as_stored(behaviour: Behaviour) -> Iterator[Violation]:
    """A root rotation M turns the body about its root: points p by M p, covariances Σ by M Σ Mᵀ.

    Why:
        A matrix multiplied from the wrong side, or read in the other memory order, is its inverse:
        the body turns the other way. One turned about the feet leaves its place; covariances may
        stay.

    Hint:
        Multiply rows from the right by Mᵀ (p Mᵀ), as the tensor holds M row by row; subtract the
        position of the root joint before, and add it afterwards. Turn covariances by M Σ Mᵀ.
    """
    entries = [entry for entry, _ in behaviour.subject.inputs_of("root_rotation")]
    fault = next(_faults_of_pairs(behaviour), "") or _fault_of_turn(behaviour)
    if fault:
        expected = "M p about the root for each centre p, and M Σ Mᵀ for each covariance Σ"
        name = entries[0].name
        tensor = behaviour.subject.graph.input(name)
        inverse = f"{name}.transpose(0, 1)" if tensor and tensor.dims == (3, 3) else f"-{name}"
        is_inverse = fault.startswith(_BACKWARDS)
        line = line_hint(f"{name} = {inverse}" if is_inverse else "", first=True)
        hint = f"Multiply rows from the right by Mᵀ. Or undo it: {line}" if line else ""
        yield Violation.at(f"input {name}", fault, expected, hint=hint)


_BACKWARDS = "the body turns backwards, by the inverse rotation"


def _faults_of_pairs(behaviour: Behaviour) -> Iterator[str]:
    """Yield the faults of rotations between runs that differ in the root rotation alone."""
    for base, probe, first, second in _pairs(behaviour, "root_rotation"):
        name = behaviour.subject.inputs_of("root_rotation")[0][0].name
        rotation_before, rotation_after = (_rotation(entry.inputs[name]) for entry in (base, probe))
        fitted_rotation = _fitted_rotation(first[:, POSITION], second[:, POSITION])
        if rotation_before is None or rotation_after is None or fitted_rotation is None:
            continue
        forward_rotation, reverse_rotation = (
            rotation_after @ rotation_before.T,
            rotation_after.T @ rotation_before,
        )
        if (
            np.linalg.norm(fitted_rotation - reverse_rotation) <= _MAX_SAME_ROTATION
            and np.linalg.norm(fitted_rotation - forward_rotation) >= _MIN_OTHER_ROTATION
        ):
            yield f"{_BACKWARDS}: the matrix is transposed"
        elif np.linalg.norm(fitted_rotation - forward_rotation) <= _MAX_SAME_ROTATION:
            yield from _faults_of_covariances(fitted_rotation, first, second)


def _faults_of_covariances(
    rotation: Float[np.ndarray, "3 3"],
    first: Float[np.ndarray, "n 10"],
    second: Float[np.ndarray, "n 10"],
) -> Iterator[str]:
    from gsgen.contract.causes.pose_readings import covariance_errors

    errors = covariance_errors(rotation, first[:, COVARIANCE], second[:, COVARIANCE])
    is_wrong, is_still = errors[0] > _MAX_COVARIANCE_ERROR, errors[1] <= _MAX_COVARIANCE_ERROR
    wrong_count, count = np.count_nonzero(is_wrong), len(is_wrong)
    if wrong_count >= _MIN_ROWS and wrong_count > _MAX_WRONG_SHARE * count:
        stays = np.count_nonzero(is_wrong & is_still) > wrong_count / 2
        words = "stay as they were" if stays else "turn otherwise"
        yield f"centres turn with the root, covariances of {wrong_count} of {count} rows {words}"


def _fault_of_turn(behaviour: Behaviour) -> str:
    """Return the fault of a body that turns in its rest pose; empty if it has none."""
    from gsgen.contract.causes.pose_readings import explain_turns

    runs, declared = behaviour.trial_runs(JOINTS), behaviour.subject.declared_gaussians
    turned = next((run for run in runs if run.probe.label.endswith(ROOT_LABEL)), None)
    if turned is None or declared is None:
        return ""
    first, second = (run.outputs.get(declared.name) for run in (runs[0], turned))
    rows = None if first is None or second is None else _rows_drawn_in_both(first, second)
    if rows is None:
        return ""
    centers, turned_centers = (part[:, POSITION].astype(np.float64) for part in rows)
    rotation = _fitted_rotation(centers, turned_centers)
    if rotation is None:
        return ""
    values = turned.probe.inputs[behaviour.subject.inputs_of("root_rotation")[0][0].name]
    explanation = explain_turns([(values.astype(np.float64), rotation)])
    if explanation is not None:
        return f"the body turns as if {explanation[0].name}"
    # A body of several roots may turn about any of them.
    manifest, size = behaviour.subject.manifest, float(np.linalg.norm(np.ptp(centers, axis=0)))
    offset = turned_centers.mean(axis=0) - rotation @ centers.mean(axis=0)
    distances = [
        (float(np.linalg.norm(rotation @ joint.rest + offset - joint.rest)) / size, joint.name)
        for entry in (manifest.inputs if manifest else ())
        for joint in entry.joints
        if joint.parent is None and joint.rest is not None
    ]
    distance, name = min(distances, default=(0.0, ""))
    if distance > _MAX_ROOT_MOTION:
        return (
            f"the body turns about another point than its root: joint {name!r} moves by "
            f"{distance:.2g} of the body's size"
        )
    return ""


def _rotation(value: np.ndarray) -> Float[np.ndarray, "3 3"] | None:
    from gsgen.contract.causes.pose_readings import declared_rotation

    if value.shape == (3, 3):
        return np.asarray(value, np.float64)
    return declared_rotation(value.astype(np.float64)) if value.shape == (3,) else None


def _fitted_rotation(
    first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "3 3"] | None:
    """Return the rotation between two point sets (Kabsch 1976); None unless it maps all points."""
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    left, sizes, right = np.linalg.svd(a.T @ b)
    if sizes[1] <= np.finfo(np.float32).eps * sizes[0]:
        return None  # the points lie on a line
    handedness = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    fitted_rotation = (left @ handedness @ right).T
    is_rigid = np.abs(a @ fitted_rotation.T - b).max() <= _MAX_RIGID_ERROR * np.abs(b).max()
    return np.asarray(fitted_rotation) if is_rigid else None
