"""Validation rules of poses: do covariances rotate with positions, limbs as the pose says?"""

from collections.abc import Callable, Iterator
from itertools import permutations

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.drawn_sample import (
    DrawnSample,
    LocalRotations,
    draw_sample,
    fit_local_rotations,
)
from gsgen.contract.probing.outputs import read_outputs
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun
from gsgen.contract.spec.fields.roles import CAMERA_ROLES
from gsgen.contract.spec.geometry import rotation_matrix, symmetric
from gsgen.contract.spec.layout import COVARIANCE
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Statistic, Violation
from gsgen.contract.validation.gates import REPRODUCIBLE, VALID_ROWS
from gsgen.contract.validation.rule import rule

_MIN_ROWS = 12
# A scene whose motion bends everywhere has a few neighbourhoods that turn rigidly by chance; a limb
# that turns is a larger fraction of the sample.
_MIN_ROW_FRACTION = 0.05
# Rows count whose neighbourhood turns rigidly by at least this angle, and whose covariance should
# change by at least this fraction of its size.
_MIN_ROTATION, _MIN_COVARIANCE_CHANGE = 0.2, 0.1
# The error of a covariance is divided by the change that it should have made: 1e-5 where it turns
# along, 1 where it stays, up to 2 where it turns backwards.
_MAX_FOLLOWING_CHANGE = 0.3
# The statistic is the share of neighbourhoods with a larger error: 0 in right models, 0.2 and more
# where one limb stays behind, which the median of all would hide.
_MAX_STAYING_SHARE = 0.1

# A neighbourhood fits a joint if it turns as the joint does, within this angle in radians.
_MAX_FITTING_DIFFERENCE = 0.1
# A reading of the pose explains the motion if at least the first fraction of rows fits a joint, and
# fails to if at most the second does.
_MIN_EXPLAINED_SHARE, _MAX_UNEXPLAINED_SHARE = 0.25, 0.02
# Joints that turn by less say nothing of the reading.
_MIN_JOINT_ANGLE = 0.3
# Radians taken for degrees turn the body by 1/57 of the angle.
_DEGREES_RATIO_RANGE = (0.5 * np.pi / 180, 2 * np.pi / 180)
_MIN_SEEN_ANGLE = 1e-4


@rule("GB035", Severity.WARNING, needs=(*REPRODUCIBLE, *VALID_ROWS))
def covariances_follow_motion(behaviour: Behaviour) -> Iterator[Violation]:
    """Where neighbouring Gaussians rotate rigidly between two runs, covariances rotate as well.

    Why:
        A limb that turns takes its Gaussians along. Covariances that stay in the rest pose, or turn
        by the inverse rotation, stand across the skin: it tears open as soon as the body moves.

    Hint:
        Turn each covariance by the rotation of its positions, R Σ Rᵀ, with R the linear part of the
        skinning transform; Rᵀ Σ R turns it backwards.
    """
    for role in behaviour.comparisons_by_role:
        if role in CAMERA_ROLES or not any(behaviour.subject.inputs_of(role)):
            continue  # the key of a single input repeats that of its role
        for sample, later_rows, motion, run in _local_motions(behaviour, role):
            violation = _pose_deviation_violation(sample, later_rows, motion, role, run)
            if violation is not None:
                yield violation
                break


def _pose_deviation_violation(
    sample: DrawnSample,
    later_rows: Float[np.ndarray, "n 10"],
    motion: LocalRotations,
    role: str,
    run: ProbeRun,
) -> Violation | None:
    covariance_before = symmetric(sample.rows[sample.inner_indices][:, COVARIANCE])
    covariance_after = symmetric(later_rows[sample.inner_indices][:, COVARIANCE])
    rotated_covariance = motion.rotation @ covariance_before @ motion.rotation.transpose(0, 2, 1)
    size = np.maximum(np.linalg.norm(covariance_before, axis=(1, 2)), np.finfo(float).tiny)
    change = np.linalg.norm(rotated_covariance - covariance_before, axis=(1, 2)) / size
    counts = motion.is_rigid & (motion.angle > _MIN_ROTATION) & (change > _MIN_COVARIANCE_CHANGE)
    if np.count_nonzero(counts) < max(_MIN_ROWS, _MIN_ROW_FRACTION * len(counts)):
        return None
    error = np.linalg.norm(covariance_after - rotated_covariance, axis=(1, 2)) / size
    covariance_difference = np.linalg.norm(covariance_after - covariance_before, axis=(1, 2)) / size
    stays = counts & (error > _MAX_FOLLOWING_CHANGE * change)
    share = np.count_nonzero(stays) / np.count_nonzero(counts)
    if share <= _MAX_STAYING_SHARE or np.count_nonzero(stays) < _MIN_ROWS / 2:
        return None
    covariance_change_text = (
        "stay as they were"
        if np.median((covariance_difference / change)[stays]) < _MAX_FOLLOWING_CHANGE
        else "turn otherwise"
    )
    actual = (
        f"covariances {covariance_change_text} in {np.count_nonzero(stays)} of "
        f"{np.count_nonzero(counts)} neighbourhoods, which turn by "
        f"{np.degrees(np.median(motion.angle[stays])):.0f}° with the {role}: error "
        f"{np.median((error / change)[stays]):.2f} of the rotation at {run.probe.label!r}"
    )
    expected = (
        f"covariances that turn with their neighbours: an error below {_MAX_FOLLOWING_CHANGE}"
    )
    change_statistic = Statistic("share of neighbourhoods", share, 0.0, _MAX_STAYING_SHARE)
    return Violation.at(
        f"role {role}", actual, expected, certainty="possible", statistic=change_statistic
    )


def _local_motions(
    behaviour: Behaviour, role: str
) -> Iterator[tuple[DrawnSample, Float[np.ndarray, "n 10"], LocalRotations, ProbeRun]]:
    """Yield visible Gaussians in runs at two poses, and the rotations of their neighbourhoods."""
    subject = behaviour.subject
    declared = subject.declared_gaussians
    base, indices = behaviour.trial.plan.variants.get(role, (0, ()))
    first = behaviour.runs((base,))
    if declared is None or not first or first[0].sample is None:
        return
    outputs = first[0].sample.outputs
    sample = draw_sample(read_outputs(subject, first[0].probe.label, outputs))
    if sample is None:
        return
    for run in behaviour.runs(indices):
        if (
            run.sample is None
            or run.sample.outputs[declared.name].shape != outputs[declared.name].shape
        ):
            continue
        later_rows = run.sample.outputs[declared.name][sample.indices].astype(np.float64)
        if np.isfinite(later_rows).all():
            yield sample, later_rows, fit_local_rotations(sample, later_rows), run


@rule("GB036", Severity.WARNING, needs=(*REPRODUCIBLE, *VALID_ROWS, "GI016"))
def pose_read_as_declared(behaviour: Behaviour) -> Iterator[Violation]:
    """Limbs rotate by the angles and about the axes that the pose input declares.

    Why:
        The same numbers are another rotation in degrees, in another order of the quaternion or of
        the axes, or inverted. Read so, joints hardly move, or bend the wrong way.

    Hint:
        Feed radians; check the order of quaternions (w x y z), the sign of rotations, the order of
        axes and joints, and the declared convention.
    """
    for role in ("pose", "root_rotation"):
        entries = [entry for entry, _ in behaviour.subject.inputs_of(role)]
        if role not in behaviour.comparisons_by_role or len(entries) != 1:
            continue
        for _, _, motion, run in _local_motions(behaviour, role):
            base = behaviour.base.probe.inputs[entries[0].name]
            convention_fault = _diagnose_convention(
                entries[0], base, run.probe.inputs[entries[0].name], motion
            )
            if convention_fault:
                actual = f"neighbourhoods turn {convention_fault} at {run.probe.label!r}"
                expected = "rotations as the convention declares them"
                yield Violation.at(
                    f"input {entries[0].name}", actual, expected, certainty="possible"
                )
                break


def _diagnose_convention(
    entry: Input, base: np.ndarray, value: np.ndarray, motion: LocalRotations
) -> str:
    """Return the wrong interpretation of a pose that explains the motion (e.g. degrees), or ""."""
    is_rigid_row = motion.is_rigid
    if np.count_nonzero(is_rigid_row) < _MIN_ROWS or base.shape == (3, 3):
        return ""
    pose_before, pose_after = (base.reshape(-1, base.shape[-1]), value.reshape(-1, base.shape[-1]))
    width = pose_before.shape[1]
    if width not in (3, 4):
        return ""
    declared = _joint_rotations(pose_before, pose_after, _MATRICES_OF_WIDTH[width])
    largest = float(_angles(declared).max())
    if largest < _MIN_JOINT_ANGLE:
        return ""
    seen_angle = float(np.quantile(motion.angle[is_rigid_row], 0.95))
    if (
        width == 3
        and seen_angle > _MIN_SEEN_ANGLE
        and _DEGREES_RATIO_RANGE[0] < seen_angle / largest < _DEGREES_RATIO_RANGE[1]
    ):
        return (
            f"by {np.degrees(seen_angle):.1f}° where joints turn by {np.degrees(largest):.0f}°, "
            "as if radians were taken for degrees"
        )
    if _explained_share(motion, declared) > _MAX_UNEXPLAINED_SHARE:
        return ""
    for name, matrices in _WRONG_POSE_CONVENTIONS[width].items():
        share = _explained_share(motion, _joint_rotations(pose_before, pose_after, matrices))
        if share >= _MIN_EXPLAINED_SHARE:
            return f"as no joint does, and in {share:.0%} of rows as if {name}"
    return ""


Matrices = Callable[[np.ndarray], Float[np.ndarray, "j 3 3"]]


def _rotations_from_axis_angle(vectors: np.ndarray) -> Float[np.ndarray, "j 3 3"]:
    half_angle = np.linalg.norm(vectors, axis=1, keepdims=True).astype(float) / 2
    scale = np.sinc(half_angle / np.pi) / 2
    return rotation_matrix(np.concatenate([np.cos(half_angle), scale * vectors], axis=1))


def _inverted_transforms(matrices: Matrices) -> Matrices:
    return lambda values: matrices(values).transpose(0, 2, 1)


def _axes(order: tuple[int, ...]) -> Matrices:
    return lambda vectors: _rotations_from_axis_angle(vectors[:, order])


_MATRICES_OF_WIDTH: dict[int, Matrices] = {3: _rotations_from_axis_angle, 4: rotation_matrix}
_WRONG_POSE_CONVENTIONS: dict[int, dict[str, Matrices]] = {
    3: {
        "rotations were inverted": _inverted_transforms(_rotations_from_axis_angle),
        "angles were halved": lambda v: _rotations_from_axis_angle(v / 2),
        "angles were doubled": lambda v: _rotations_from_axis_angle(v * 2),
        "numbers of all joints were read x first, then y and z": lambda v: (
            _rotations_from_axis_angle(v.reshape(3, -1).T)
        ),
        **{
            f"axes x y z were read as {' '.join('xyz'[axis] for axis in order)}": _axes(order)
            for order in permutations(range(3))
            if order != (0, 1, 2)
        },
    },
    4: {
        "quaternions w x y z were read as x y z w": lambda q: rotation_matrix(
            np.roll(q, 1, axis=1)
        ),
        "rotations were inverted": _inverted_transforms(rotation_matrix),
    },
}


def _joint_rotations(
    pose_before: np.ndarray, pose_after: np.ndarray, matrices: Matrices
) -> Float[np.ndarray, "j 3 3"]:
    """Return the rotation of each joint from one pose to another."""
    return np.asarray(matrices(pose_after) @ matrices(pose_before).transpose(0, 2, 1))


def _angles(matrices: Float[np.ndarray, "... 3 3"]) -> Float[np.ndarray, "..."]:
    cosine = (np.trace(matrices, axis1=-2, axis2=-1) - 1) / 2
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))


def _explained_share(motion: LocalRotations, joints: Float[np.ndarray, "j 3 3"]) -> float:
    """Return the fraction of rigid neighbourhoods of Gaussians that rotate like some joint."""
    rotation = motion.rotation[motion.is_rigid]
    difference = _angles(rotation[:, None] @ joints.transpose(0, 2, 1)[None])
    return float((difference.min(axis=1) < _MAX_FITTING_DIFFERENCE).mean())
