"""Rules of declared inputs (GI): ranges, defaults and conventions that a runtime can use."""

__all__ = ["declared_inputs", "shape_of"]

from collections.abc import Iterator
from math import prod

from gsgen.contract.model.graph import static_dims
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.fields.roles import (
    CONVENTION_SHAPES,
    JOINTS,
    MANIFEST_KINDS,
    ROLES,
    ROTATION_ROLES,
    matches_shape,
)
from gsgen.contract.spec.manifest import Input, TrajectoryManifest
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, set_hint
from gsgen.contract.validation.rule import rule

_TIME_ROLES = ("time", "frame_index")
_SQUARE_SHAPES = ((4, 4), (3, 3))
_QUATERNION_SIZE = 4
_AXIS_ANGLE = 3
# Two decimals more than 2π: a range may be rounded up.
_FULL_TURN_RADIANS = 6.3
# The rounding error of a decimal number that is read as binary.
_ROUNDING = 1e-6
# Numbers of float32 from 1 to 2, and the largest numbers of float32 and int32.
_FLOAT32_STEPS = 2**23
_MAX_FLOAT32, _MAX_INT32 = 3.4028234663852886e38, 2**31 - 1
# A runtime knows the camera, the clock, the window and the picture; users set these roles.
_USER_ROLES = (
    *("pose", "shape", "expression", "root_translation", "root_rotation"),
    *("appearance_id", "control", "timestep", "conditioning", "audio", "condition"),
    *("image_view", "image_intrinsics"),
)


def _input_location(entry: Input) -> str:
    return f"manifest input {entry.name}"


def declared_inputs(subject: InspectedModel) -> tuple[Input, ...]:
    """Return the model inputs that the manifest declares."""
    return subject.manifest.inputs if subject.manifest else ()


def shape_of(subject: InspectedModel, entry: Input) -> tuple[int, ...] | None:
    """Return the size of every axis of a model input, from the graph or else the manifest."""
    tensor = subject.graph.input(entry.name)
    dims = static_dims(tensor) if tensor else None
    return entry.shape if dims is None else tuple(int(dim) for dim in dims)


@rule("GI013", Severity.ERROR, needs=("GM004",), kinds=MANIFEST_KINDS)
def input_range_ordered(subject: InspectedModel) -> Iterator[Violation]:
    """A declared input range runs from low to high, in numbers that the input can hold.

    Why:
        A slider drawn for [1, 0] runs backwards or not at all, a clip to it gives one constant, and
        no frame has the number 7.5.

    Hint:
        Write "range": [low, high]; for frame numbers, identities and timesteps with whole numbers.
    """
    for entry in declared_inputs(subject):
        if entry.range is None:
            continue
        (low, high), tensor = entry.range, subject.graph.input(entry.name)
        actual = f"range {[low, high]}"
        dtype = (tensor.dtype if tensor else None) or "float32"
        is_int32 = dtype == "int32"
        lowest, highest = (
            (-_MAX_INT32 - 1, _MAX_INT32) if is_int32 else (-_MAX_FLOAT32, _MAX_FLOAT32)
        )
        is_whole = ROLES[entry.role].index or is_int32
        if not low <= high:
            yield Violation.at(_input_location(entry), actual, "low <= high")
        elif is_whole and not (low.is_integer() and high.is_integer()):
            yield Violation.at(_input_location(entry), actual, "whole numbers")
        elif low < lowest or high > highest:
            expected = f"numbers of {dtype}, from {lowest:.10g} to {highest:.10g}"
            ends = [max(low, lowest), min(high, highest)]
            path = f"{subject.path_of(entry)}.range"
            hint = set_hint(path, [int(end) if is_int32 else end for end in ends])
            yield Violation.at(_input_location(entry), actual, expected, hint=hint)


@rule(
    "GI014",
    Severity.ERROR,
    needs=("GM005", "GI001", "GI002", "GI003", "GI005", "GI013"),
    kinds=MANIFEST_KINDS,
)
def input_default_fits(subject: InspectedModel) -> Iterator[Violation]:
    """A declared default fills its input, lies in its range, and is whole for integer inputs.

    Why:
        It is what every runtime feeds first. One of another size cannot be fed, and one outside the
        range starts a slider beyond its end.

    Hint:
        Give one number for all elements, as many as there are (row-major), "zeros", or "identity"
        for matrices and quaternions.
    """
    for entry in declared_inputs(subject):
        shape = shape_of(subject, entry)
        if entry.default is None or shape is None:
            continue
        fault = _default_value_fault(entry, shape)
        if fault is not None:
            yield Violation.at(_input_location(entry), *fault)


def _default_value_fault(entry: Input, shape: tuple[int, ...]) -> tuple[str, str] | None:
    """Return the fault of an input's default value, and the expected value; None if it fits."""
    default = entry.default
    is_quaternion_pose = entry.role == "pose" and shape[-1:] == (_QUATERNION_SIZE,)
    if default == "identity" and not (shape[-2:] in _SQUARE_SHAPES or is_quaternion_pose):
        return f"default identity for shape {list(shape)}", "a matrix or quaternions"
    if isinstance(default, tuple) and len(default) != prod(shape):
        actual = f"default of {len(default)} numbers for shape {list(shape)}"
        return actual, f"{prod(shape)} numbers"
    numbers = _default_numbers(entry)
    low, high = entry.range or (min(numbers, default=0), max(numbers, default=0))
    room = _ROUNDING * max(abs(low), abs(high), 1.0)
    out_of_range = [number for number in numbers if not low - room <= number <= high + room]
    if out_of_range:
        return f"default {out_of_range[0]:g} beyond the range {[low, high]}", "one within"
    if ROLES[entry.role].index and not all(number.is_integer() for number in numbers):
        return f"default {numbers[0]:g} of an input that counts", "a whole number"
    return None


def _default_numbers(entry: Input) -> tuple[float, ...]:
    """Return the distinct numbers that an input's default consists of."""
    words: dict[object, tuple[float, ...]] = {"zeros": (0.0,), "identity": (0.0, 1.0)}
    default = entry.default
    if isinstance(default, str):
        return words[default]
    return tuple(map(float, default if isinstance(default, tuple) else (default or 0.0,)))


@rule("GI015", Severity.ERROR, needs=("GM004", "GI005"), kinds=MANIFEST_KINDS)
def input_convention_known(subject: InspectedModel) -> Iterator[Violation]:
    """A declared input convention (such as axis-angle) suits the input's role and shape.

    Why:
        A runtime that drives an avatar writes rotations as the convention says. It cannot follow
        one that it does not know, nor write quaternions into rows of three.

    Hint:
        Name one of the role's conventions, as the page of roles lists them, or none.
    """
    for entry in declared_inputs(subject):
        if entry.convention is None:
            continue
        known, shape = ROLES[entry.role].conventions, shape_of(subject, entry)
        actual = f"convention {entry.convention!r}"
        if entry.convention not in known:
            expected = f"one of {', '.join(known)}" if known else f"none, as {entry.role} has"
            yield Violation.at(_input_location(entry), actual, expected)
        elif shape is not None and not _shape_fits_convention(entry, shape):
            expected = "a shape that can hold it"
            yield Violation.at(
                _input_location(entry), f"{actual} for shape {list(shape)}", expected
            )
        elif shape is not None and shape[0] not in JOINTS.get(entry.convention, shape[:1]):
            joints = " or ".join(map(str, JOINTS[entry.convention]))
            expected = f"{joints} joints; a skeleton of its own has no convention of SMPL"
            yield Violation.at(_input_location(entry), f"{actual} for {shape[0]} joints", expected)


def _shape_fits_convention(entry: Input, shape: tuple[int, ...]) -> bool:
    convention = entry.convention
    if (entry.role, convention) in CONVENTION_SHAPES:
        return matches_shape(CONVENTION_SHAPES[entry.role, str(convention)], shape)
    if convention == "matrix":
        return shape == (3, 3)
    if convention == "quaternion-wxyz":
        return shape[-1:] == (_QUATERNION_SIZE,)
    # [3, 3] is three joints of a pose, but a matrix of a root.
    return shape[-1:] == (_AXIS_ANGLE,) and (entry.role != "root_rotation" or len(shape) == 1)


@rule("GI017", Severity.ERROR, needs=("GM004",), kinds=MANIFEST_KINDS)
def timing_belongs_to_time(subject: InspectedModel) -> Iterator[Violation]:
    """Only time inputs declare frames, fps and loop; rates and steps of time are above 0.

    Why:
        A player divides by fps and by step_seconds: at 0 the time stands still or is infinite. A
        slider with frames is moved by no timeline.

    Hint:
        Declare loop, frames and fps for the roles time and frame_index alone, and the rate that
        the scene was recorded at; leave fps out if it is unknown.
    """
    for entry in declared_inputs(subject):
        timing_fields = {"loop": entry.loop, "fps": entry.fps, "frames": entry.frames}
        declared = [name for name, value in timing_fields.items() if value is not None]
        if declared and entry.role not in _TIME_ROLES:
            actual = f"role {entry.role} with {', '.join(declared)}"
            yield Violation.at(_input_location(entry), actual, "role time or frame_index")
        elif entry.fps == 0:
            yield Violation.at(_input_location(entry), "fps 0", "frames per second above 0")
    if isinstance(subject.manifest, TrajectoryManifest) and not subject.manifest.step_seconds:
        yield Violation.at("manifest step_seconds", "0 seconds", "a time above 0")


@rule("GI025", Severity.ERROR, needs=("GM004", "GI013"))
def frames_fit_range(subject: InspectedModel) -> Iterator[Violation]:
    """The range of a clock has a number of its own for each frame.

    Why:
        A runtime steps through the whole numbers of a frame index. Frames beyond them are never
        shown, and the speed of frames / fps is wrong. A time is float32: in seconds since 1970 it
        moves by 128 s at once.

    Hint:
        Declare as many "frames" as the range has whole numbers or, where the model has more,
        "range": [0, frames - 1]; the range [0, 1] belongs to a time. Let times start at 0.
    """
    for entry in declared_inputs(subject):
        if entry.role not in _TIME_ROLES or entry.range is None or entry.frames is None:
            continue
        low, high = entry.range
        if entry.role == "frame_index":
            numbers = int(high - low) + 1
        else:
            # At x, neighbouring numbers of float32 are at most |x| · 2⁻²³ apart.
            size = max(abs(low), abs(high)) or 1.0
            numbers = max(1, int((high - low) / size * _FLOAT32_STEPS))
        if entry.frames > numbers:
            actual = f"{entry.frames} frames in the range {list(entry.range)}"
            expected = f"{numbers} distinct frames at most"
            yield Violation.at(
                _input_location(entry), actual, expected, hint=_frames_hint(subject, entry, numbers)
            )


def _frames_hint(subject: InspectedModel, entry: Input, numbers: int) -> str:
    if entry.role != "time":
        return ""
    fewer = set_hint(f"{subject.path_of(entry)}.frames", numbers)
    return f"Let times start at 0. Or: {fewer}"


@rule("GI018", Severity.ERROR, needs=("GM004", "GI015"), kinds=MANIFEST_KINDS)
def angles_are_radians(subject: InspectedModel) -> Iterator[Violation]:
    """The declared range of a rotation vector lies within ±2π, since angles are in radians.

    Why:
        A slider in degrees turns a joint 57 times too far: almost its whole length shows a body
        that spins.

    Hint:
        Divide degrees by 180 and multiply by π, in the range and in what is fed.
    """
    for entry in declared_inputs(subject):
        shape = shape_of(subject, entry)
        if entry.role not in ROTATION_ROLES or entry.range is None or shape is None:
            continue
        is_vector = shape[-1:] == (_AXIS_ANGLE,) and entry.convention != "matrix"
        if is_vector and shape != (3, 3) and max(map(abs, entry.range)) > _FULL_TURN_RADIANS:
            actual = f"range {list(entry.range)}, which looks like degrees"
            yield Violation.at(_input_location(entry), actual, "radians, within ±2π (±6.28)")


@rule("GI016", Severity.WARNING, needs=("GM004",), kinds=MANIFEST_KINDS)
def input_has_a_start(subject: InspectedModel) -> Iterator[Violation]:
    """An input that no runtime can fill by itself, such as a pose, declares a default value.

    Why:
        Cameras, clocks and windows are known everywhere; a pose or a body shape is not. Without a
        default a runtime feeds the low end of the range, which is a body at its most extreme, or
        zeros, and the first picture is not what the author would show.

    Hint:
        Declare "default": a number, a list, "zeros" or "identity".
    """
    if subject.candidate is not None:
        return
    for entry in declared_inputs(subject):
        if entry.role in _USER_ROLES and entry.default is None:
            low = "zeros" if entry.range is None else f"{entry.range[0]:g}, the low end,"
            actual = f"role {entry.role} without a default: {low} would be fed"
            yield Violation.at(_input_location(entry), actual, '"default"')
