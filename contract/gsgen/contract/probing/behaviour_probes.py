"""Test inputs of behaviour rules: range ends, flipped axes, loops, frames, order of runs."""

__all__ = [
    "HIGH_END",
    "HISTORIES",
    "JOINTS",
    "LONG_QUATERNIONS_LABEL",
    "LOOKING_AWAY_LABEL",
    "MOVED_ALONE",
    "MOVED_TOGETHER",
    "NEGATED_LABEL",
    "ORDER",
    "ORDER_FRAMES",
    "OTHER_LENSES",
    "PATH_OFFSET",
    "PICTURE_CAMERAS",
    "REPEATED_LABEL",
    "ROOT_LABEL",
    "SINGLE_JOINT_ANGLE",
    "STEADY_TURN_LABEL",
    "STEPS",
    "STEP_OFFSETS",
    "STRAIGHT_PATH_LABEL",
    "TILTED_LABEL",
    "ZERO_LABEL",
    "joints_of_label",
    "trial_probes",
    "turned_away_probes",
]

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final, Literal

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.probes import (
    Array,
    Probe,
    as_tensor,
    cast_array,
    straight_path,
    turning_path,
)
from gsgen.contract.spec.fields.roles import CAMERA_ROLES, PICTURE_ROLES, ROLES
from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.contract.spec.manifest import GeneratorManifest, Input, Manifest, TrajectoryManifest

# Suffix of the label of a probe that is run a second time.
REPEATED_LABEL = "once more"

# Displacement of a camera path, in world units.
PATH_OFFSET = (3.0, -2.0, 5.0)
# Name of the group of paths that turn through half a turn.
HISTORIES = "histories"
# Suffix of the label of a path whose quaternions have the other sign.
NEGATED_LABEL = "with quaternions negated"
# Part of the labels of paths of constant velocity, and the
# directions of three of them, which are orthogonal to each other.
STRAIGHT_PATH_LABEL = "on a straight path"
# Multiples of a path's speed at which it is run again.
_PATH_SPEEDS = (0.1, 8.0)
# Part of the labels of paths that turn, and the angle of each step of theirs, in radians.
STEADY_TURN_LABEL, _PATH_TURN = "on a steady turn", 0.2
_PATH_DIRECTIONS = np.array([[2.0, 1.0, -2.0], [1.0, 2.0, 2.0], [-2.0, 2.0, -1.0]]) / 3

# Camera displacement, as a fraction of the distance from the origin.
_CAMERA_STEP = 0.3
# Relative overshoot beyond a declared range that rounding may cause.
_BEYOND_RANGE_FRACTION = 0.01
# Frames around the middle of the range, and at its end, within which a model is run as well.
_WINDOW_FRAMES = 2
_FRAME_FRACTION = 0.3
_STEPS_PER_RANGE = 60
# Part of the label of a probe in which the inputs of one role are zero.
ZERO_LABEL = "with zero"
# Names of the probes within two frames and of the first and last frames; where in a frame.
STEPS, ORDER = "steps", "order"
# Name of the probe at the end of a clock that does not loop.
HIGH_END = "at the high end of the time"
STEP_OFFSETS, ORDER_FRAMES = (0.1, 0.5, 0.9), (0, 1, 2, -3, -2, -1)
# Name of the probes in which joints turn alone, the angle in radians, and the most joints.
JOINTS, SINGLE_JOINT_ANGLE = "joints", 0.8
_MAX_JOINTS, _JOINT_LABEL = 24, "with a turn of joint "
_MAX_UNDECLARED_JOINTS = 6
_ROOT_AT_REST: Final[dict[str, Literal["zeros", "identity"]]] = {
    "root_translation": "zeros",
    "root_rotation": "identity",
}
# Parts of the labels in which the body turns, and in which a child turns with its parent.
ROOT_LABEL, _MAX_CHAINS, _CHAIN_LABEL = "with a turn of the root", 2, "with turns of joints "
LONG_QUATERNIONS_LABEL, _LONG = "with quaternions of length 1.1", 1.1
# Axes that no bone of a usual rest pose lies along.
_JOINT_AXIS, _CHILD_AXIS = np.array([2.0, 3.0, 6.0]) / 7, np.array([6.0, -2.0, 3.0]) / 7
# Name of the probes with other cameras of pictures; the rigid motion of all of them, and by how much
# focal lengths and principal points differ, in fractions of the picture.
PICTURE_CAMERAS = "picture cameras"
MOVED_TOGETHER, OTHER_LENSES = "with all cameras of pictures moved", "with other lenses"
MOVED_ALONE = "with another camera of picture "
_PICTURE_MOTION = np.eye(4)
_PICTURE_MOTION[:3, :3] = rotation_matrix(np.array([[0.92, 0.2, -0.28, 0.19]]))[0]
_PICTURE_MOTION[:3, 3] = (0.4, -0.3, 0.5)
_FOCAL_FACTORS, _PRINCIPAL_SHIFT = (1.25, 0.8), (0.125, -0.1875)
_MAX_MOVED_PICTURES = 4
# Suffixes of the labels of a camera that is turned about its own centre.
TILTED_LABEL, LOOKING_AWAY_LABEL = "tilted", "looking away"
# A tilt by 0.7 about the viewing axis and 0.15 about the vertical, and half a turn.
_TILT_ROTATION = rotation_matrix(np.array([[0.9365, 0.0, 0.07, 0.3429]]))[0]
_HALF_TURN_ROTATION = np.diag([-1.0, 1.0, -1.0])
# Instants between those of other probes, and the short step of a time from 0 to 1.
_SAMPLE_TIMES = (0.35, 0.75)
_SMALL_TIME_STEP = 0.01
_MAX_UNIT_RANGE = 1.0
_REFRESH_RATE = 60.0


def trial_probes(
    manifest: Manifest, base: Probe, first: tuple[Probe, ...]
) -> Iterator[tuple[str, tuple[Probe, ...]]]:
    """Yield (group name, test inputs) for every behaviour rule that needs inputs of its own.

    Args:
        manifest: Declares the role of each input.
        base: The probe that most of them are derived from.
        first: The probes of value rules.
    """
    if isinstance(manifest, GeneratorManifest):
        yield "moved", tuple(_moved_camera_probes(manifest, base))
        yield "turned", tuple(_turned_camera_probes(manifest, base))
        yield "flipped", tuple(_flipped_axis_probes(manifest, base))
        yield "edges", tuple(_edge_probes(manifest, base))
        yield "outside", tuple(_outside_range_probes(manifest, base))
        yield JOINTS, tuple(_joint_probes(manifest, base))
        yield PICTURE_CAMERAS, tuple(_picture_camera_probes(manifest, base))
        for entry in manifest.inputs:
            if entry.role == "time" and entry.range is not None:
                yield "loop", tuple(_loop_probes(entry, base))
                yield "paces", tuple(_time_step_probes(entry, base))
                yield "within frames", tuple(_frame_window_probes(entry, base))
                yield "swept", tuple(_sweep_probes(manifest, entry, base))
                yield STEPS, tuple(_step_probes(entry, base))
                if entry.frames and not entry.loop:
                    probe = _probe_at_fraction(entry, base, 1.0)
                    yield HIGH_END, (replace(probe, label=HIGH_END, survey=True),)
            if entry.role in ("time", "frame_index") and entry.range is not None:
                yield ORDER, tuple(_order_probes(entry, base))
    if isinstance(manifest, TrajectoryManifest):
        yield "paths", tuple(_path_probes(manifest, base))
    if len(first) > 1:
        repeated_indices = dict.fromkeys((len(first) - 1, len(first) // 2, 1))
        yield (
            "again",
            tuple(_changed_probe(first[index], REPEATED_LABEL) for index in repeated_indices),
        )
    yield "plain", (replace(_changed_probe(base, "without optimisations"), optimise=False),)


def turned_away_probes(manifest: Manifest, base: Probe) -> Iterator[Probe]:
    """Yield test inputs whose camera is turned by 180° about the camera's y axis."""
    if isinstance(manifest, GeneratorManifest):
        order = manifest.space.matrix_order if manifest.space else "column"
        for entry in _inputs_of_role(manifest, "view")[:1]:
            rear_view = np.diag([-1.0, 1.0, -1.0, 1.0]) @ as_tensor(base.inputs[entry.name], order)
            yield _changed_probe(base, "looking away", **{entry.name: as_tensor(rear_view, order)})


def _changed_probe(base: Probe, words: str, **inputs: Array) -> Probe:
    return Probe(label=f"{base.label} {words}", inputs=base.inputs | inputs, extra=True)


def _path_probes(manifest: TrajectoryManifest, base: Probe) -> Iterator[Probe]:
    """Yield test inputs of camera paths: unchanged, moved, at rest, with negated quaternions."""
    quaternions = manifest.outputs.future.representation == "position+quaternion-wxyz"
    for entry in _inputs_of_role(manifest, "camera_history")[:1]:
        camera_history = base.inputs[entry.name]
        if camera_history.ndim != 2:
            return
        moved_history, negated_history = camera_history.copy(), camera_history.copy()
        moved_history[:, :3] += np.array(PATH_OFFSET, camera_history.dtype)
        yield _changed_probe(base, "again", **{entry.name: camera_history})
        yield _changed_probe(base, "moved", **{entry.name: moved_history})
        yield _changed_probe(
            base, "at rest", **{entry.name: np.repeat(camera_history[-1:], len(camera_history), 0)}
        )
        for number, direction in enumerate(_PATH_DIRECTIONS):
            path = straight_path(camera_history, direction)
            yield _changed_probe(base, f"{STRAIGHT_PATH_LABEL} {number}", **{entry.name: path})
        for speed in _PATH_SPEEDS:
            path = straight_path(camera_history, _PATH_DIRECTIONS[0], speed, entry.range)
            label = f"{STRAIGHT_PATH_LABEL} at {speed:g} of the speed"
            yield _changed_probe(base, label, **{entry.name: path})
        for number, axis in enumerate(_PATH_DIRECTIONS):
            path = turning_path(camera_history, axis * _PATH_TURN)
            yield _changed_probe(base, f"{STEADY_TURN_LABEL} {number}", **{entry.name: path})
        if quaternions:
            negated_history[:, 3:] *= -1
            yield _changed_probe(base, NEGATED_LABEL, **{entry.name: negated_history})


def _inputs_of_role(manifest: Manifest, role: str) -> list[Input]:
    return [entry for entry in manifest.inputs if entry.role == role]


def _moved_camera_probes(manifest: GeneratorManifest, base: Probe) -> Iterator[Probe]:
    """Yield test inputs of the camera: unchanged, moved, and moved by the transposed matrix."""
    order = manifest.space.matrix_order if manifest.space else "column"
    for entry in _inputs_of_role(manifest, "view")[:1]:
        view = base.inputs[entry.name]
        matrix = as_tensor(view, order)  # transposing is its own inverse
        step = np.zeros((4, 4))
        step[:3, 3] = _CAMERA_STEP * max(float(np.linalg.norm(matrix[:3, 3])), 1.0)
        tensor = as_tensor(step, order)
        yield _changed_probe(base, "again", **{entry.name: view})
        yield _changed_probe(base, "moved", **{entry.name: view + tensor})
        yield _changed_probe(base, "moved, transposed", **{entry.name: view + tensor.T})


def _turned_camera_probes(manifest: GeneratorManifest, base: Probe) -> Iterator[Probe]:
    """Yield test inputs whose camera is turned about its own centre: tilted, and looking away."""
    order = manifest.space.matrix_order if manifest.space else "column"
    for entry in _inputs_of_role(manifest, "view")[:1]:
        view = as_tensor(base.inputs[entry.name], order).astype(np.float64)
        for words, rotation in (
            (TILTED_LABEL, _TILT_ROTATION),
            (LOOKING_AWAY_LABEL, _HALF_TURN_ROTATION),
        ):
            turn_matrix = np.eye(4)
            turn_matrix[:3, :3] = rotation
            yield _changed_probe(base, words, **{entry.name: as_tensor(turn_matrix @ view, order)})


def _sweep_probes(manifest: GeneratorManifest, entry: Input, base: Probe) -> Iterator[Probe]:
    """Yield test inputs at instants over the time range, and at close pairs of instants."""
    assert entry.range is not None
    low, high = entry.range
    is_short_range = entry.frames is None and 0 < high - low <= _MAX_UNIT_RANGE
    if is_short_range or len(manifest.inputs) > 1:  # otherwise the first probes hold such instants
        yield from (
            _probe_at_fraction(entry, base, range_fraction) for range_fraction in _SAMPLE_TIMES
        )
    if is_short_range:
        range_fraction = (float(base.inputs[entry.name].reshape(-1)[0]) - low) / (high - low)
        yield from (
            _probe_at_fraction(entry, base, start + _SMALL_TIME_STEP)
            for start in (range_fraction, *_SAMPLE_TIMES)
        )


def _joint_probes(manifest: GeneratorManifest, base: Probe) -> Iterator[Probe]:
    """Yield the rest pose with all other inputs of a person at their defaults, then turns.

    The root is where joints are declared, neither moved nor turned, whichever its defaults are. Up
    to 24 joints of a declared skeleton turn alone, those nearest to the root first, or six rows of
    any other pose; then the body turns; then children turn together with their parents.
    """
    from gsgen.contract.spec.input_defaults import default_tensor

    entry = next(iter(_inputs_of_role(manifest, "pose")), None)
    template = base.inputs[entry.name] if entry else np.zeros(0)
    if entry is None or template.ndim != 2 or template.shape[1] not in (3, 4):
        return
    is_skeleton = len(entry.joints) == len(template)
    rest = np.zeros_like(template)
    rest[:, 0] = float(template.shape[1] == 4)
    try:
        defaults = {
            other.name: default_tensor(
                replace(other, default=_ROOT_AT_REST.get(other.role, other.default)),
                base.inputs[other.name].shape,
            )
            for other in manifest.inputs
            if other.role not in (*CAMERA_ROLES, *PICTURE_ROLES)
        }
    except ValueError:
        return  # another rule reports a default of another size
    inputs = {name: value.astype(base.inputs[name].dtype) for name, value in defaults.items()}
    yield _changed_probe(base, "in the rest pose", **inputs | {entry.name: rest})
    if is_skeleton:
        joints = _joints_from_the_root(entry)[:_MAX_JOINTS]
    else:
        count = min(len(template), _MAX_UNDECLARED_JOINTS)
        joints = sorted({round(row) for row in np.linspace(0, len(template) - 1, count)})
    for joint in joints:
        yield _changed_probe(
            base, f"{_JOINT_LABEL}{joint}", **inputs | {entry.name: _turned(rest, joint)}
        )
    if template.shape[1] == 4:
        pose = np.asarray(_LONG * rest, rest.dtype)
        yield _changed_probe(base, LONG_QUATERNIONS_LABEL, **inputs | {entry.name: pose})
    for root in _inputs_of_role(manifest, "root_rotation"):
        if base.inputs[root.name].shape == (3,) and is_skeleton:
            turn = np.asarray(SINGLE_JOINT_ANGLE * _JOINT_AXIS, base.inputs[root.name].dtype)
            yield _changed_probe(base, ROOT_LABEL, **inputs | {entry.name: rest, root.name: turn})
    for parent, child in _chains(entry)[:_MAX_CHAINS] if is_skeleton else ():
        pose = _turned(_turned(rest, parent), child, _CHILD_AXIS)
        yield _changed_probe(base, f"{_CHAIN_LABEL}{parent} {child}", **inputs | {entry.name: pose})


def _turned(pose: Array, joint: int, axis: Float[np.ndarray, "3"] = _JOINT_AXIS) -> Array:
    """Return a pose in which one joint is turned from rest, by axis-angle or a quaternion."""
    pose, half = pose.copy(), SINGLE_JOINT_ANGLE / 2
    if pose.shape[1] == 4:
        pose[joint] = [math.cos(half), *(math.sin(half) * axis)]
    else:
        pose[joint] = SINGLE_JOINT_ANGLE * axis
    return pose


def _chains(entry: Input) -> list[tuple[int, int]]:
    """Return numbers of parents and children, those that carry most joints first, roots' last."""
    numbers = {joint.name: number for number, joint in enumerate(entry.joints)}
    parents = [numbers.get(joint.parent or "") for joint in entry.joints]
    carried = [0] * len(parents)
    for number in reversed(_joints_from_the_root(entry)):
        parent = parents[number]
        if parent is not None:
            carried[parent] += 1 + carried[number]
    chains = [(parent, number) for number, parent in enumerate(parents) if parent is not None]
    return sorted(chains, key=lambda chain: (parents[chain[0]] is None, -carried[chain[1]]))


def _joints_from_the_root(entry: Input) -> list[int]:
    """Return the numbers of a pose's joints, those with fewer ancestors first."""
    depths: dict[str | None, int] = {None: 0}
    for joint in entry.joints:
        depths[joint.name] = depths.get(joint.parent, 0) + 1
    return sorted(range(len(entry.joints)), key=lambda k: depths[entry.joints[k].name])


def joints_of_label(label: str) -> tuple[int, ...]:
    """Return the number of the joint that turns alone in a probe, or of a parent and its child."""
    for words in (_JOINT_LABEL, _CHAIN_LABEL):
        if words in label:
            return tuple(map(int, label.rpartition(words)[2].split()))
    return ()


def _picture_camera_probes(manifest: GeneratorManifest, base: Probe) -> Iterator[Probe]:
    """Yield test inputs with all cameras of pictures moved, with other lenses, and with one moved.

    Pictures stay the same: rows that are placed along their rays follow their cameras.
    """
    order = manifest.space.matrix_order if manifest.space else "column"
    motion = np.linalg.inv(_PICTURE_MOTION)
    for entry in _inputs_of_role(manifest, "image_view")[:1]:
        views = base.inputs[entry.name]
        if views.ndim != 3 or views.shape[1:] != (4, 4):
            return
        moved = np.stack([as_tensor(as_tensor(view, order) @ motion, order) for view in views])
        yield _changed_probe(base, MOVED_TOGETHER, **{entry.name: moved})
        for lens in _inputs_of_role(manifest, "image_intrinsics")[:1]:
            matrices = base.inputs[lens.name].copy()
            if matrices.shape[1:] == (3, 3):
                size = 2 * matrices[:, :2, 2]  # the principal point is the middle
                matrices[:, [0, 1], [0, 1]] *= _FOCAL_FACTORS
                matrices[:, :2, 2] += size * _PRINCIPAL_SHIFT
                yield _changed_probe(base, OTHER_LENSES, **{lens.name: matrices})
        for number in range(min(len(views), _MAX_MOVED_PICTURES) if len(views) > 1 else 0):
            alone = views.copy()
            alone[number] = moved[number]
            yield _changed_probe(base, f"{MOVED_ALONE}{number}", **{entry.name: alone})


def _flipped_axis_probes(manifest: GeneratorManifest, base: Probe) -> Iterator[Probe]:
    """Yield test inputs with the projection matrix unchanged, and with its second row negated."""
    order = manifest.space.matrix_order if manifest.space else "column"
    for entry in _inputs_of_role(manifest, "projection")[:1]:
        lens = base.inputs[entry.name]
        flipped_matrix = as_tensor(np.diag([1.0, -1.0, 1.0, 1.0]) @ as_tensor(lens, order), order)
        yield _changed_probe(base, "again", **{entry.name: lens})
        yield _changed_probe(base, "with y turned", **{entry.name: flipped_matrix})


def _edge_probes(manifest: GeneratorManifest, base: Probe) -> Iterator[Probe]:
    """Yield test inputs with one input role zero at a time, then all inputs at range ends."""
    for role in dict.fromkeys(entry.role for entry in manifest.inputs):
        names = [entry.name for entry in _inputs_of_role(manifest, role)]
        zeros = {name: np.zeros_like(base.inputs[name]) for name in names}
        yield replace(_changed_probe(base, f"{ZERO_LABEL} {role}", **zeros), survey=True)
    for end, words in ((0, "at the lowest"), (1, "at the highest")):
        ends = {
            entry.name: _array_filled_with(base.inputs[entry.name], span[end])
            for entry in manifest.inputs
            if (span := _input_range(entry, base.inputs[entry.name])) is not None
        }
        if ends:
            yield replace(_changed_probe(base, words, **ends), survey=True)


def _input_range(entry: Input, value: Array) -> tuple[float, float] | None:
    """Return the ends of an input's range; rotation angles of poses are limited to ±π."""
    angles = entry.role in ("pose", "root_rotation") and value.shape[-1:] == (3,)
    if entry.range is None and angles and value.shape != (3, 3):
        return -math.pi, math.pi
    return entry.range


def _outside_range_probes(manifest: GeneratorManifest, base: Probe) -> Iterator[Probe]:
    """Yield test inputs with all ranged inputs just below their range, then just above it."""
    ranged_inputs = [
        (entry, entry.range)
        for entry in manifest.inputs
        if entry.range is not None and not ROLES[entry.role].index
    ]
    for sign, end, words in ((-1, 0, "just below"), (1, 1, "just above")):
        inputs = {
            entry.name: _array_filled_with(
                base.inputs[entry.name],
                span[end] + sign * _BEYOND_RANGE_FRACTION * (span[1] - span[0]),
            )
            for entry, span in ranged_inputs
        }
        if inputs:
            yield _changed_probe(base, f"{words} the declared ranges", **inputs)


def _array_filled_with(template: Array, value: float) -> Array:
    return cast_array(np.full(template.shape, value), template.dtype.name)


def _probe_at_fraction(entry: Input, base: Probe, range_fraction: float) -> Probe:
    assert entry.range is not None
    low, high = entry.range
    value = low * (1 - range_fraction) + high * range_fraction
    template = base.inputs[entry.name]
    return _changed_probe(
        base, f"at time={value:.6g}", **{entry.name: _array_filled_with(template, value)}
    )


def _loop_probes(entry: Input, base: Probe) -> Iterator[Probe]:
    """Yield test inputs at the first two and the last two instants of a looping time range."""
    if entry.loop:
        step = 1 / (entry.frames or _STEPS_PER_RANGE)
        for range_fraction in (0.0, step, 1 - step, 1.0):
            yield _probe_at_fraction(entry, base, range_fraction)


def _time_step_probes(entry: Input, base: Probe) -> Iterator[Probe]:
    """Yield test inputs at pairs of instants that are one 60 Hz screen refresh apart.

    The second pair has the beginning of a frame in its middle.
    """
    if entry.frames and entry.fps:
        step = min(1.0, entry.fps / entry.frames / _REFRESH_RATE)
        middle = entry.frames // 2 / entry.frames
        for start in (0.0, max(0.0, middle - step / 2), middle, 1 - step):
            if start + step <= 1:
                yield _probe_at_fraction(entry, base, start)
                yield _probe_at_fraction(entry, base, start + step)


def _frame_window_probes(entry: Input, base: Probe) -> Iterator[Probe]:
    """Yield test inputs within some frames, in the middle of the range and at its end.

    A model that rounds time down to one frame too few shows one frame twice, near the middle
    of the range.
    """
    count = entry.frames or 0
    middle_frame = int(_FRAME_FRACTION * count)
    middle = range(max(0, middle_frame - _WINDOW_FRAMES), middle_frame + _WINDOW_FRAMES)
    for frame in sorted({*middle, *range(max(0, count - _WINDOW_FRAMES), count)}):
        if frame < count > 1:
            probe = _probe_at_fraction(entry, base, (frame + _FRAME_FRACTION) / count)
            yield replace(probe, label=f"within frame {frame}", survey=True)


def _step_probes(entry: Input, base: Probe) -> Iterator[Probe]:
    """Yield test inputs at several instants within each of two frames, in the middle of the range."""
    count = entry.frames or 0
    middle = (count - 1) // 2
    if count > 2:
        for frame in (middle, middle + 1):
            for offset in STEP_OFFSETS:
                probe = _probe_at_fraction(entry, base, (frame + offset) / count)
                yield replace(probe, survey=True)


def _order_probes(entry: Input, base: Probe) -> Iterator[Probe]:
    """Yield test inputs within the first three frames and the last three."""
    assert entry.range is not None
    low, high = entry.range
    count = entry.frames or 0
    if entry.role == "frame_index":
        count = min(count or int(high - low) + 1, int(high - low) + 1)
    if count < len(ORDER_FRAMES):
        return
    for frame in ORDER_FRAMES:
        number = frame % count
        if entry.role == "time":
            probe = _probe_at_fraction(entry, base, (number + _FRAME_FRACTION) / count)
        else:
            value = _array_filled_with(base.inputs[entry.name], math.ceil(low) + number)
            probe = _changed_probe(base, "", **{entry.name: value})
        yield replace(probe, label=f"frame {number} in order")
