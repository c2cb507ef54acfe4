"""Rules of skeletons (GB): joints stand where the manifest says, and children follow their parents."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.probing.behaviour_probes import JOINTS, SINGLE_JOINT_ANGLE, joint_of_label
from gsgen.contract.probing.run_comparison import Behaviour
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, POSITION
from gsgen.contract.spec.manifest import Input, Joint
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import FINITE_OUTPUTS, REPRODUCIBLE
from gsgen.contract.validation.rule import rule

# So many rows must turn rigidly with a joint for a statement about it.
_MIN_ROWS = 12
# Rows turn rigidly if a fit leaves at most this share of the body's size.
_MAX_RESIDUAL = 2e-3
_FIT_ROUNDS = 8
# The fitted angle differs from that of the joint by at most this share: rows that hang on several
# joints turn by less.
_MAX_ANGLE_ERROR = 0.05
# A joint moves by at most this share of the body's size when it alone turns: 0.000 for right
# skeletons, 0.35 and 0.70 for joints that are exchanged or relative to their parents.
_MAX_JOINT_MOTION = 0.05
# Rows move if they do so by this share of the body's size.
_MIN_MOTION = 1e-3
# Fewer of a joint's rows than this share follow its parent: 1.00 for right skeletons, 0.00 for
# parents of another limb.
_MIN_FOLLOWING_SHARE = 0.1


class _Turn(NamedTuple):
    """The rows of one run in which a joint alone turned, beside those at rest."""

    entry: Input
    joint: Joint
    rest: Float[np.ndarray, "n 3"]
    turned: Float[np.ndarray, "n 3"]
    size: float

    @property
    def moved(self) -> Bool[np.ndarray, " n"]:
        """The mask of the rows that the joint moves."""
        distance = np.linalg.norm(self.turned - self.rest, axis=1)
        return np.asarray(distance > _MIN_MOTION * self.size)


def _turns(behaviour: Behaviour) -> list[_Turn]:
    """Return the runs in which one joint turned; rows that are not drawn at rest are left out."""
    declared, manifest = behaviour.subject.declared_gaussians, behaviour.subject.manifest
    runs = behaviour.trial_runs(JOINTS)
    entry = next((e for e in (manifest.inputs if manifest else ()) if e.joints), None)
    if declared is None or entry is None or len(runs) < 2:
        return []
    rest = runs[0].outputs.get(declared.name)
    if rest is None:
        return []
    drawn = (rest[:, OPACITY] >= CULL_OPACITY) & np.isfinite(rest[:, POSITION]).all(axis=1)
    positions = rest[drawn, POSITION].astype(np.float64)
    if len(positions) < _MIN_ROWS:
        return []
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    turns = []
    for run in runs[1:]:
        rows = run.outputs.get(declared.name)
        if rows is not None and rows.shape == rest.shape and size > 0:
            turned = rows[drawn, POSITION].astype(np.float64)
            joint = entry.joints[joint_of_label(run.probe.label)]
            turns.append(_Turn(entry, joint, positions, turned, size))
    return turns


@rule("GB060", Severity.ERROR, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS, "GI030", "GO016"))
def joints_stand_where_declared(behaviour: Behaviour) -> Iterator[Violation]:
    """A joint that turns alone stays at its declared position: its rows turn about that point.

    Why:
        Tools that retarget motion and draw skeletons take the position of a joint from the
        manifest. With those of other joints, or relative to the parent, limbs turn beside the body.

    Hint:
        Give each joint's position in the rest pose in local units, from the origin and not from its
        parent, in the order of the rows of the pose.
    """
    for turn in _turns(behaviour):
        motion = _joint_motion(turn)
        if motion is not None and motion > _MAX_JOINT_MOTION:
            expected = f"at most {_MAX_JOINT_MOTION} of the body's size"
            actual = (
                f"joint {turn.joint.name!r} moves by {motion:.2f} of the body's size when it alone "
                "turns: its rows turn about another point"
            )
            yield Violation.at(f"manifest input {turn.entry.name}", actual, expected)


def _joint_motion(turn: _Turn) -> float | None:
    """Return how far the rigid motion of a joint's rows moves the joint, in sizes of the body.

    None if too few rows turn rigidly by the angle of the joint.
    """
    if turn.joint.rest is None:
        return None
    fitted = turn.moved & np.isfinite(turn.turned).all(axis=1)
    for _ in range(_FIT_ROUNDS):
        if np.count_nonzero(fitted) < _MIN_ROWS:
            return None
        rotation, offset = _rigid_motion(turn.rest[fitted], turn.turned[fitted])
        residual = np.linalg.norm(turn.rest @ rotation.T + offset - turn.turned, axis=1)
        if residual[fitted].max() <= _MAX_RESIDUAL * turn.size:
            break
        # The worse half is left out: those are rows that hang on several joints.
        limit = max(float(np.median(residual[fitted])), _MAX_RESIDUAL * turn.size / 2)
        fitted &= residual <= limit
    else:
        return None
    cosine = (np.trace(rotation) - 1) / 2
    angle = float(np.arccos(np.clip(cosine, -1, 1)))
    if abs(angle - SINGLE_JOINT_ANGLE) > _MAX_ANGLE_ERROR * SINGLE_JOINT_ANGLE:
        return None
    joint = np.array(turn.joint.rest)
    return float(np.linalg.norm(rotation @ joint + offset - joint)) / turn.size


def _rigid_motion(
    rest: Float[np.ndarray, "n 3"], turned: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Return rotation and translation of the best rigid motion between points (Kabsch 1976)."""
    centers = rest.mean(axis=0), turned.mean(axis=0)
    left, _, right = np.linalg.svd((turned - centers[1]).T @ (rest - centers[0]))
    left[:, 2] *= np.sign(np.linalg.det(left @ right)) or 1.0
    rotation = left @ right
    return rotation, centers[1] - rotation @ centers[0]


@rule("GB061", Severity.ERROR, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS, "GI030", "GO016"))
def children_follow_parents(behaviour: Behaviour) -> Iterator[Violation]:
    """The rows that a joint moves also move when its declared parent turns.

    Why:
        A tool that retargets motion turns limbs relative to the parent that the manifest names.
        With another parent, a raised arm leaves the hand behind.

    Hint:
        Name as "parent" the joint that carries this one in the model's own skeleton; check that
        joints stand in the order of the rows of the pose.
    """
    moved_by = {turn.joint.name: (turn, turn.moved) for turn in _turns(behaviour)}
    for name, (turn, rows) in moved_by.items():
        parent = turn.joint.parent
        if parent not in moved_by or np.count_nonzero(rows) < _MIN_ROWS:
            continue
        if np.count_nonzero(moved_by[parent][1]) < _MIN_ROWS:
            continue  # the parent moves nothing: a root whose rotation is another input
        share = float(np.mean(moved_by[parent][1][rows]))
        if share < _MIN_FOLLOWING_SHARE:
            actual = (
                f"{100 * share:.0f} % of the rows of joint {name!r} move with its parent {parent!r}"
            )
            yield Violation.at(
                f"manifest input {turn.entry.name}", actual, "rows that follow the parent"
            )
