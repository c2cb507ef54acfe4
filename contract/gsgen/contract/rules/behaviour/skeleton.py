"""Rules of skeletons (GB): joints turn as given, where they stand, and children follow parents."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.probing.behaviour_probes import (
    JOINTS,
    LONG_QUATERNIONS_LABEL,
    SINGLE_JOINT_ANGLE,
    joints_of_label,
)
from gsgen.contract.probing.run_comparison import Behaviour
from gsgen.contract.spec.layout import COVARIANCE, CULL_OPACITY, OPACITY, POSITION
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, line_hint, remove_hint
from gsgen.contract.validation.gates import FINITE_OUTPUTS, REPRODUCIBLE
from gsgen.contract.validation.rule import rule

if TYPE_CHECKING:
    from gsgen.contract.causes.pose_readings import Reading

# So many rows must turn rigidly with a joint for a statement about it.
_MIN_ROWS = 12
# Rows turn rigidly if a fit leaves at most the first share of the body's size, and at most the
# second share of their motion.
_MAX_RESIDUAL, _MAX_RESIDUAL_OF_MOTION = 2e-3, 0.05
_FIT_ROUNDS = 8
# The fitted angle differs from that of the joint by at most this share: rows that hang on several
# joints turn by less.
_MAX_ANGLE_ERROR = 0.05
# Covariances follow if they are within the first share of the change that they should make: at most
# the second share of all does in models that forget them, of which the third shows one mistake.
_MAX_COVARIANCE_ERROR, _MAX_FOLLOWING_SHARE, _MIN_EXPLAINED_SHARE = 0.3, 0.1, 0.8
# A joint moves by at most this share of the body's size when it alone turns: 0.000 for right
# skeletons, 0.01 where the rest pose sways with the time, 0.35 and 0.70 for joints that are
# exchanged or relative to their parents.
_MAX_JOINT_MOTION = 0.05
# A smaller share than that counts where one factor fits all joints, so that the second share of
# their distances remains: 0.009 for rows three per cent too small, 0.024 for a body eight per cent
# taller. Factors below the third, and fewer joints, say nothing.
_MAX_SCALED_MOTION, _MAX_SCALE_MISFIT, _MIN_SCALE_ERROR, _MIN_SCALED_JOINTS = 5e-3, 0.2, 0.01, 4
# Rows move if they do so by this share of the body's size.
_MIN_MOTION = 1e-3
# Fewer of the rows that a joint turns rigidly than the first share follow its parent, or of all
# that it moves than the second: 1.00 for right skeletons, 0.00 for parents of another limb, and up
# to 0.3 of all rows for a grandparent, as neighbouring joints share rows.
_MIN_FOLLOWING_SHARE, _MIN_FOLLOWING_SHARE_OF_ALL = 0.5, 0.1
# Rows that a parent carries turn by less, in radians, if it does not turn them; in degrees, 0.014.
_MAX_CARRIED_ANGLE = 0.005
# Two turns in the wrong order give another rotation, 0.6 radians from the right one; a fitted one
# is that within this angle.
_MAX_CHAIN_ERROR = 0.05
# Rows move by at most this share of the body's size if quaternions become longer: 0.00 in models
# that normalise them, 0.01 where numbers are blended and nothing turns, 0.12 and more in others.
_MAX_MOTION_BY_LENGTH = 0.05


class _Turn(NamedTuple):
    """The rows of one run in which joints turned, beside those at rest."""

    joints: tuple[int, ...]
    values: Float[np.ndarray, "j w"]
    rows_at_rest: Float[np.ndarray, "n 10"]
    turned_rows: Float[np.ndarray, "n 10"]
    size: float

    @property
    def rest(self) -> Float[np.ndarray, "n 3"]:
        """The centres at rest."""
        return self.rows_at_rest[:, POSITION]

    @property
    def turned(self) -> Float[np.ndarray, "n 3"]:
        """The centres after the turn."""
        return self.turned_rows[:, POSITION]

    @property
    def moved(self) -> Bool[np.ndarray, " n"]:
        """The mask of the rows that the joint moves."""
        distance = np.linalg.norm(self.turned - self.rest, axis=1)
        return np.asarray(distance > _MIN_MOTION * self.size)

    def motion(
        self, *, rigid: bool = True, among: Bool[np.ndarray, " n"] | None = None
    ) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"], np.ndarray] | None:
        """Fit a rigid motion to the rows that hang on the joint alone; return it and those rows.

        None if too few rows turn rigidly.

        Args:
            rigid: Whether the matrix is a rotation; any matrix otherwise.
            among: The mask of the rows that are fitted; by default all.
        """
        from gsgen.contract.causes.pose_readings import affine_motion, rigid_motion

        fit = rigid_motion if rigid else affine_motion
        distance = np.linalg.norm(self.turned - self.rest, axis=1)
        fitted = self.moved & np.isfinite(distance) & (True if among is None else among)
        for _ in range(_FIT_ROUNDS):
            if np.count_nonzero(fitted) < _MIN_ROWS:
                return None
            rotation, offset = fit(self.rest[fitted], self.turned[fitted])
            residual = np.linalg.norm(self.rest @ rotation.T + offset - self.turned, axis=1)
            limit = min(
                _MAX_RESIDUAL * self.size, _MAX_RESIDUAL_OF_MOTION * np.median(distance[fitted])
            )
            if residual[fitted].max() <= limit:
                return rotation, offset, fitted
            # The worse half is left out: those are rows that hang on several joints.
            fitted &= residual <= max(float(np.median(residual[fitted])), limit / 2)
        return None


def _entry(behaviour: Behaviour) -> Input | None:
    manifest = behaviour.subject.manifest
    entries = manifest.inputs if manifest else ()
    return next((entry for entry in entries if entry.role == "pose"), None)


def _turns(behaviour: Behaviour) -> list[_Turn]:
    """Return the runs in which joints turned; rows that are not drawn at rest are left out."""
    declared, entry = behaviour.subject.declared_gaussians, _entry(behaviour)
    runs = behaviour.trial_runs(JOINTS)
    rest = runs[0].outputs.get(declared.name) if declared and runs else None
    if declared is None or entry is None or rest is None:
        return []
    drawn = (rest[:, OPACITY] >= CULL_OPACITY) & np.isfinite(rest[:, POSITION]).all(axis=1)
    rows_at_rest = rest[drawn].astype(np.float64)
    positions = rows_at_rest[:, POSITION]
    size = float(np.linalg.norm(np.ptp(positions, axis=0))) if len(positions) >= _MIN_ROWS else 0.0
    turns = []
    for run in runs[1:]:
        rows, joints = run.outputs.get(declared.name), joints_of_label(run.probe.label)
        if rows is not None and rows.shape == rest.shape and size > 0 and joints:
            values = run.probe.inputs[entry.name][list(joints)].astype(np.float64)
            turned_rows = rows[drawn].astype(np.float64)
            turns.append(
                _Turn(
                    joints=joints,
                    values=values,
                    rows_at_rest=rows_at_rest,
                    turned_rows=turned_rows,
                    size=size,
                )
            )
    return turns


def _misread_turns(behaviour: Behaviour) -> "tuple[Input, Reading, str] | None":
    """Return the pose input, the wrong reading that explains turns of joints, and the turns in words."""
    from gsgen.contract.causes.pose_readings import angles_of, explain_turns

    entry = _entry(behaviour)
    # A wrong matrix may be no rotation: where no rows turn rigidly, any matrix is fitted.
    motions = [
        (turn.values[0], motion[0])
        for turn in _turns(behaviour)
        if len(turn.joints) == 1
        and (motion := turn.motion() or turn.motion(rigid=False)) is not None
    ]
    explanation = explain_turns(motions) if entry is not None and motions else None
    if entry is None or explanation is None:
        return None
    reading, share = explanation
    seen_angle = np.degrees(float(np.median([angles_of(rotation) for _, rotation in motions])))
    actual = (
        f"{share:.0%} of the joints that turn alone by {np.degrees(SINGLE_JOINT_ANGLE):.0f}° turn "
        f"their rows by {seen_angle:.3g}°, as if {reading.name}"
    )
    return entry, reading, actual


@rule("GB068", Severity.ERROR, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS, "GI015", "GO016"))
def joints_turn_as_given(behaviour: Behaviour) -> Iterator[Violation]:
    """A joint that turns alone turns its rows, covariances too, by the rotation that it is given.

    Why:
        The same numbers are another rotation in degrees, as Euler angles, inverted, or with w last.
        Read so, joints hardly move, or bend the wrong way. Covariances that stay, or turn the other
        way, stand across the skin.

    Hint:
        Feed radians; check the sign of rotations and the order of quaternions, w x y z. Turn
        covariances by R Σ Rᵀ.
    """
    fault = _fault_of_covariances(behaviour)
    if fault is not None:
        entry, actual = fault
        hint = (
            "Turn each covariance by the linear part R of its row's skinning transform, R Σ Rᵀ; "
            "Rᵀ Σ R turns it backwards."
        )
        yield Violation.at(f"input {entry.name}", actual, "R Σ Rᵀ of each row's Σ", hint=hint)
    misread = _misread_turns(behaviour)
    if misread is not None and misread[1].is_certain:
        entry, reading, actual = misread
        expected = "the rotation that the convention defines, right-handed and in radians"
        hint = _hint_of(entry, reading)
        yield Violation.at(f"input {entry.name}", actual, expected, hint=hint)


def _hint_of(entry: Input, reading: "Reading") -> str:
    line = line_hint(reading.line.replace("pose", entry.name), first=True)
    return f"{reading.hint} {line}".strip()


def _fault_of_covariances(behaviour: Behaviour) -> tuple[Input, str] | None:
    """Return the pose input, and what covariances do instead of turning with their rows."""
    from gsgen.contract.causes.pose_readings import covariance_errors

    entry = _entry(behaviour)
    errors = [
        covariance_errors(
            motion[0],
            turn.rows_at_rest[motion[2], COVARIANCE],
            turn.turned_rows[motion[2], COVARIANCE],
        )
        for turn in _turns(behaviour)
        if len(turn.joints) == 1 and (motion := turn.motion()) is not None
    ]
    count = sum(part.shape[1] for part in errors)
    if entry is None or count < _MIN_ROWS:
        return None
    following, still, inverse = np.mean(np.hstack(errors) <= _MAX_COVARIANCE_ERROR, axis=1)
    share, words = max((still, "stay as they were"), (inverse, "turn the other way"))
    if following > _MAX_FOLLOWING_SHARE or share < _MIN_EXPLAINED_SHARE:
        return None
    actual = f"centres turn with their joints, {share:.0%} of {count} covariances {words}"
    return entry, actual


@rule("GB036", Severity.WARNING, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS, "GI015", "GO016", "GB068"))
def pose_read_as_declared(behaviour: Behaviour) -> Iterator[Violation]:
    """Limbs rotate about the axes of local space that the pose input gives.

    Why:
        A pose of another program has other axes: Unity's are left-handed, others have z up. If the
        numbers are read as they come, arms that should rise swing forwards.

    Hint:
        Convert poses where they are loaded, and let the model take axes x y z of its own space.
    """
    misread = _misread_turns(behaviour)
    if misread is not None and not misread[1].is_certain:
        entry, reading, actual = misread
        expected = "rotations about the axes that are given"
        hint = _hint_of(entry, reading)
        yield Violation.at(f"input {entry.name}", actual, expected, certainty="possible", hint=hint)
    share = _motion_by_length(behaviour)
    if share > _MAX_MOTION_BY_LENGTH:
        pose = _entry(behaviour)
        assert pose is not None
        actual = (
            f"rows move by {share:.2g} of the body's size if all quaternions have length 1.1: they "
            "are not normalised"
        )
        hint = (
            "Divide each quaternion by its length inside the model: interpolated ones are shorter."
        )
        yield Violation.at(
            f"input {pose.name}", actual, "the same rows", certainty="possible", hint=hint
        )


def _motion_by_length(behaviour: Behaviour) -> float:
    """Return how far rows move at rest if quaternions become longer, in sizes of the body."""
    runs, declared = behaviour.trial_runs(JOINTS), behaviour.subject.declared_gaussians
    longer = next((r for r in runs if r.probe.label.endswith(LONG_QUATERNIONS_LABEL)), None)
    if longer is None or declared is None:
        return 0.0
    rest, rows = (run.outputs.get(declared.name) for run in (runs[0], longer))
    if rest is None or rows is None or rest.shape != rows.shape:
        return 0.0
    drawn = rest[:, OPACITY] >= CULL_OPACITY
    motion = np.linalg.norm((rows - rest)[drawn, POSITION].astype(np.float64), axis=1)
    size = float(np.linalg.norm(np.ptp(rest[drawn, POSITION], axis=0))) if drawn.any() else 0.0
    return float(np.median(motion)) / size if size > 0 else 0.0


@rule("GB060", Severity.ERROR, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS, "GI030", "GO016", "GB068"))
def joints_stand_where_declared(behaviour: Behaviour) -> Iterator[Violation]:
    """A joint that turns alone stays at its declared position: its rows turn about that point.

    Why:
        Tools that retarget motion and draw skeletons take the position of a joint from the
        manifest. With those of other joints, of another body, or relative to the parent, limbs turn
        beside the body.

    Hint:
        Give each joint's position in the rest pose in local units, from the origin and not from its
        parent, in the order of the rows of the pose.
    """
    from gsgen.contract.causes.pose_readings import angles_of

    entry, size = _entry(behaviour), 0.0
    joints, motions, names = [], [], []
    for turn in _turns(behaviour):
        joint = entry.joints[turn.joints[0]] if entry and entry.joints else None
        motion = turn.motion() if len(turn.joints) == 1 and joint and joint.rest else None
        if joint is None or joint.rest is None or motion is None:
            continue
        if abs(angles_of(motion[0]) - SINGLE_JOINT_ANGLE) <= _MAX_ANGLE_ERROR * SINGLE_JOINT_ANGLE:
            joints.append(np.array(joint.rest))
            motions.append(motion[:2])
            names.append(joint.name)
            size = turn.size
    if entry is None or not joints:
        return
    shares = [
        float(np.linalg.norm(rotation @ joint + offset - joint)) / size
        for joint, (rotation, offset) in zip(joints, motions, strict=True)
    ]
    wrong_joints = [k for k, share in enumerate(shares) if share > _MAX_JOINT_MOTION]
    factor = _factor_of_joints(joints, motions) if max(shares) > _MAX_SCALED_MOTION else None
    hint = ""
    if factor is not None:
        wrong_joints = [int(np.argmax(shares))]
        hint = (
            f"Multiply all joints' positions by {factor:.4g}: they are of a body of another size. "
            "If they are right, divide the skinning weights of each row by their sum."
        )
    for number in wrong_joints:
        expected = (
            f"at most {_MAX_SCALED_MOTION if factor else _MAX_JOINT_MOTION} of the body's size"
        )
        actual = (
            f"joint {names[number]!r} moves by {shares[number]:.2g} of the body's size when it "
            "alone turns: its rows turn about another point"
        )
        if factor is not None:
            actual += f", as all do, {factor:.4g} times as far from the origin as the rest joints"
        yield Violation.at(f"manifest input {entry.name}", actual, expected, hint=hint)


def _factor_of_joints(
    joints: list[Float[np.ndarray, "3"]],
    motions: list[tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]],
) -> float | None:
    """Return by which factor joints stand farther from the origin than declared; None if by none.

    The points of a rigid motion that stay are a line; it is compared across its direction.
    """
    displacements = [np.eye(3) - rotation for rotation, _ in motions]
    lines = [
        displacement @ joint for displacement, joint in zip(displacements, joints, strict=True)
    ]
    declared, seen = np.concatenate(lines), np.concatenate([offset for _, offset in motions])
    if len(joints) < _MIN_SCALED_JOINTS or not declared.any():
        return None
    factor = float(declared @ seen / (declared @ declared))
    misfit = np.linalg.norm(seen - factor * declared)
    distance = np.linalg.norm(seen - declared)
    is_factor = misfit <= _MAX_SCALE_MISFIT * distance and abs(factor - 1) >= _MIN_SCALE_ERROR
    return factor if is_factor and factor > 0 else None


@rule("GB061", Severity.ERROR, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS, "GI030", "GO016"))
def children_follow_parents(behaviour: Behaviour) -> Iterator[Violation]:
    """The rows that a joint moves also move and turn with its declared parent, after the joint.

    Why:
        A tool that retargets motion turns limbs relative to the parent that the manifest names.
        With another parent, a raised arm leaves the hand behind; with global rotations, it stays
        upright.

    Hint:
        Name as "parent" the joint that carries this one in the model's own skeleton; check that
        joints stand in the order of the rows of the pose.
    """
    entry, turns = _entry(behaviour), _turns(behaviour)
    if entry is None or not entry.joints:
        return
    where = f"manifest input {entry.name}"
    single_turns = {turn.joints[0]: turn for turn in turns if len(turn.joints) == 1}
    numbers = {joint.name: number for number, joint in enumerate(entry.joints)}
    for number, turn in single_turns.items():
        name, parent = entry.joints[number].name, entry.joints[number].parent
        parent_turn = single_turns.get(numbers.get(parent or "", -1))
        if parent_turn is None or np.count_nonzero(turn.moved) < _MIN_ROWS:
            continue
        if np.count_nonzero(parent_turn.moved) < _MIN_ROWS:
            continue  # the parent moves nothing: a root whose rotation is another input
        motion = turn.motion()
        rows, limit = (
            (turn.moved, _MIN_FOLLOWING_SHARE_OF_ALL)
            if motion is None
            else (motion[2], _MIN_FOLLOWING_SHARE)
        )
        share = float(np.mean(parent_turn.moved[rows]))
        if share < limit:
            actual = (
                f"{100 * share:.0f} % of the rows of joint {name!r} move with its parent {parent!r}"
            )
            hint = remove_hint(
                f"{behaviour.subject.path_of(entry)}.joints.{number}.parent",
                "name the joint that carries this one in the model's own skeleton; check that "
                "joints stand in the order of the rows of the pose",
            )
            yield Violation.at(where, actual, "rows that follow the parent", hint=hint)
    yield from _children_that_keep_their_rotation(entry, single_turns)
    for turn in turns:
        if len(turn.joints) == 2 and _is_chain_reversed(turn, single_turns):
            parent, name = (entry.joints[number].name for number in turn.joints)
            actual = f"rows of joint {name!r} turn as if its parent {parent!r} turned before it"
            hint = "Multiply the transform of the parent by that of the joint: G = G_parent · L."
            yield Violation.at(where, actual, "the joint's turn, then the parent's", hint=hint)


def _children_that_keep_their_rotation(
    entry: Input, single_turns: dict[int, _Turn]
) -> Iterator[Violation]:
    """Yield a violation if parents carry the rows of nearly all children, but do not turn them."""
    from gsgen.contract.causes.pose_readings import angles_of

    numbers = {joint.name: number for number, joint in enumerate(entry.joints)}
    angles = []
    for number, turn in single_turns.items():
        parent_turn = single_turns.get(numbers.get(entry.joints[number].parent or "", -1))
        motion = parent_turn.motion(among=turn.moved) if parent_turn is not None else None
        if motion is not None:
            angles.append(float(angles_of(motion[0])))
    kept = [angle for angle in angles if angle <= _MAX_CARRIED_ANGLE]
    if kept and len(kept) >= _MIN_EXPLAINED_SHARE * len(angles):
        actual = (
            f"the rows of {len(kept)} of {len(angles)} joints move with the parent, but do not turn "
            "with it: rotations were taken as global"
        )
        hint = "Multiply each joint's rotation by that of its parent: G = G_parent · L."
        expected = "rows that turn with the parent"
        yield Violation.at(f"manifest input {entry.name}", actual, expected, hint=hint)


def _is_chain_reversed(turn: _Turn, single_turns: dict[int, _Turn]) -> bool:
    """Return whether rows turn by the rotation of a parent first, and then by that of its child."""
    from gsgen.contract.causes.pose_readings import angles_of, declared_rotation, rigid_motion

    rows = np.ones(len(turn.rest), bool)
    for joint in turn.joints:
        motion = single_turns[joint].motion() if joint in single_turns else None
        if motion is None:
            return False
        expected = declared_rotation(single_turns[joint].values[0])
        if angles_of(motion[0] @ expected.T) > _MAX_ANGLE_ERROR * SINGLE_JOINT_ANGLE:
            return False  # the joint has axes of its own, which the manifest does not tell
        rows &= motion[2]
    if np.count_nonzero(rows) < _MIN_ROWS:
        return False
    parent, child = (declared_rotation(values) for values in turn.values)
    rotation, _ = rigid_motion(turn.rest[rows], turn.turned[rows])
    error = angles_of(rotation @ (parent @ child).T)
    reversed_error = angles_of(rotation @ (child @ parent).T)
    return bool(error > 2 * _MAX_CHAIN_ERROR and reversed_error <= _MAX_CHAIN_ERROR)
