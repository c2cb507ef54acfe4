"""Validation rules of root motion: translations are added, and rotations are not inverted."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.run_comparison import Behaviour
from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, POSITION
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import REPRODUCIBLE
from gsgen.contract.validation.rule import rule

_MIN_ROWS = 4
# All rows move alike if they differ by less than this fraction, and as told within the second.
_MAX_RIGID_ERROR = 5e-3
_MAX_VALUE_ERROR = 0.02
# Distances of rotations, as the Frobenius norm of their difference.
_MAX_SAME_ROTATION, _MIN_OTHER_ROTATION = 0.02, 0.2

_RunPair = tuple[Probe, Probe, Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]


def _pairs(behaviour: Behaviour, role: str) -> Iterator[_RunPair]:
    """Yield pairs of model runs that differ in one input, and the Gaussians' centres in both."""
    declared = behaviour.subject.declared_gaussians
    runs = behaviour.variants(role)
    if declared is None or len(behaviour.subject.inputs_of(role)) != 1 or len(runs) < 2:
        return
    base, first = runs[0][0], np.asarray(runs[0][1][declared.name], np.float64)
    for probe, outputs in runs[1:]:
        second = np.asarray(outputs[declared.name], np.float64)
        if first.shape != second.shape:
            continue
        drawn = (first[:, OPACITY] >= CULL_OPACITY) & (second[:, OPACITY] >= CULL_OPACITY)
        drawn &= np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
        if np.count_nonzero(drawn) >= _MIN_ROWS:
            yield base, probe, first[drawn, POSITION], second[drawn, POSITION]


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
        row_motion = second - first
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
            yield Violation.at(f"input {name}", actual, expected)
            return


def _vector_text(vector: Float[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{value:.3g}' for value in vector)})"


@rule("GB042", Severity.ERROR, needs=(*REPRODUCIBLE, "GO001", "GO002", "GO016", "GI015"))
def root_rotation_as_stored(behaviour: Behaviour) -> Iterator[Violation]:
    """A root rotation M that rotates the body rigidly maps each point p to M p, not to Mᵀ p.

    Why:
        A matrix that is multiplied from the wrong side, or read in the other memory order, is its
        inverse: the body turns the other way, and is right at rest alone.

    Hint:
        Multiply rows from the right by Mᵀ (p Mᵀ), as the tensor holds M row by row.
    """
    for base, probe, first, second in _pairs(behaviour, "root_rotation"):
        name = behaviour.subject.inputs_of("root_rotation")[0][0].name
        rotation_before, rotation_after = (_rotation(entry.inputs[name]) for entry in (base, probe))
        fitted_rotation = _fitted_rotation(first, second)
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
            actual = "the body turns backwards, by the inverse rotation: the matrix is transposed"
            yield Violation.at(f"input {name}", actual, "M p for each centre p")
            return


def _rotation(value: np.ndarray) -> Float[np.ndarray, "3 3"] | None:
    if value.shape == (3, 3):
        return np.asarray(value, np.float64)
    if value.shape != (3,):
        return None
    vector = np.asarray(value, np.float64)
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle else vector
    quaternion = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])
    return np.asarray(rotation_matrix(quaternion[None])[0])


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
