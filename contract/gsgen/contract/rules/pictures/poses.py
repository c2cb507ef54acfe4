"""Validation rules of poses: do covariances rotate with positions?"""

from collections.abc import Iterator

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
from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.layout import COVARIANCE
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


@rule("GB035", Severity.WARNING, needs=(*REPRODUCIBLE, *VALID_ROWS, "GB042", "GB068"))
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
        if role in CAMERA_ROLES or not behaviour.subject.inputs_of(role):
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
