"""Named moments: inputs that the manifest or the specification names, each run once.

A declared default is what every viewer shows first, t(k) is when a frame begins, people look
from above, and pictures have black pixels. Rules of single runs hold at each of these moments.
"""

__all__ = ["FRAMES", "OPEN_SIZES", "PICTURES", "NamedMoment", "moments_of"]

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gsgen.contract.probing.behaviour_probes import HISTORIES
from gsgen.contract.probing.picture_probes import synthetic_pictures, test_patterns
from gsgen.contract.probing.probes import Array, Probe, as_tensor, cast_array, turning_path
from gsgen.contract.probing.survey_probes import corner_inputs, ranged_inputs_of, survey_probes
from gsgen.contract.spec.fields.roles import CAMERA_ROLES, MATRIX_ROLES, PICTURE_ROLES, STATE_SIZES
from gsgen.contract.spec.geometry import perspective
from gsgen.contract.spec.input_defaults import default_tensor
from gsgen.contract.spec.manifest import (
    GeneratorManifest,
    Input,
    Manifest,
    PostProcessManifest,
    TrajectoryManifest,
)

# Names of groups: a moment for each declared frame, test pictures, and sizes of pictures.
FRAMES, PICTURES, OPEN_SIZES = "frames", "pictures", "open sizes"
# Pictures wide and tall, as screens and telephones have them.
_VIEWPORTS = {"landscape": (1920.0, 1080.0), "portrait": (1080.0, 1920.0)}
_FIELD_OF_VIEW = math.radians(60.0)
_PLANES = (0.01, 1000.0)
# Sizes of pictures where the graph leaves them open: no multiple of 8, of 16, and of 64.
_OPEN_SIZES = ((67, 93), (72, 104), (112, 80))
_MAX_CORNERS = 8
# The most frames that are run: more than two minutes at 30 frames per second.
_MAX_FRAMES = 4096
# The angle of each step of a path that turns, in radians.
_TURN_STEP = 0.1


class NamedMoment(NamedTuple):
    """One named moment: the group that rules ask for, and its test inputs."""

    group: str
    probe: Probe


def moments_of(
    manifest: Manifest, first: tuple[Probe, ...], open_axes: dict[int, int], limit: int
) -> Iterator[NamedMoment]:
    """Yield the named moments of a model, those that people meet first at the front.

    Args:
        manifest: Declares role, range, default and frames of each input.
        first: The probes of value rules, of which the first is all zeros.
        open_axes: The axes of a post-process model's image that the graph leaves open: which
            number of a size each takes.
        limit: The largest number of cameras around a scene.
    """
    if len(first) < 2:
        return
    base = first[1]
    yield from (NamedMoment("defaults", probe) for probe in _default_moments(manifest, base))
    for entry in manifest.inputs:
        frames = _frame_moments(entry, base)
        yield from (NamedMoment(FRAMES, probe) for probe in frames)
    if isinstance(manifest, GeneratorManifest):
        yield from (NamedMoment("survey", probe) for probe in survey_probes(manifest, first, limit))
        yield from (NamedMoment("screens", probe) for probe in _screen_moments(manifest, base))
        yield from (NamedMoment(PICTURES, probe) for probe in _picture_moments(manifest, base))
    if isinstance(manifest, PostProcessManifest):
        yield from (NamedMoment("corners", probe) for probe in _corner_moments(manifest, base))
        yield from (NamedMoment(PICTURES, probe) for probe in _picture_moments(manifest, base))
        yield from (
            NamedMoment(OPEN_SIZES, probe) for probe in _size_moments(manifest, base, open_axes)
        )
    if isinstance(manifest, TrajectoryManifest):
        yield from (NamedMoment(HISTORIES, probe) for probe in _history_moments(manifest, base))


def _moment(label: str, base: Probe, inputs: dict[str, Array], *, survey: bool = True) -> Probe:
    return Probe(label=label, inputs=base.inputs | inputs, extra=True, survey=survey)


def _default_moments(manifest: Manifest, base: Probe) -> Iterator[Probe]:
    """Yield the moment in which nothing is fed but defaults, and that with a camera and pictures."""
    is_generator = isinstance(manifest, GeneratorManifest)
    space = manifest.space if isinstance(manifest, GeneratorManifest) else None
    is_transposed = space is None or space.matrix_order == "column"
    defaults = {}
    for entry in manifest.inputs:
        template = base.inputs[entry.name]
        try:
            value = default_tensor(entry, template.shape)
        except ValueError:
            return  # GI014 reports a default of another size
        if entry.role in MATRIX_ROLES and is_transposed:
            value = np.swapaxes(value, -1, -2)
        defaults[entry.name] = cast_array(np.ascontiguousarray(value), template.dtype.name)
    seen = {
        entry.name for entry in manifest.inputs if entry.role in (*CAMERA_ROLES, *PICTURE_ROLES)
    }
    if isinstance(manifest, TrajectoryManifest):
        return  # another probe holds a history of zeros
    yield _moment("the defaults", base, defaults, survey=is_generator)
    if seen and len(seen) < len(defaults):
        others = {name: value for name, value in defaults.items() if name not in seen}
        words = "the defaults, seen by a camera" if is_generator else "the defaults, with a picture"
        yield _moment(words, base, others, survey=is_generator)


def _frame_moments(entry: Input, base: Probe) -> Iterator[Probe]:
    """Yield the moment at which each frame of a time or a frame number begins."""
    if entry.range is None or entry.role not in ("time", "frame_index"):
        return
    template, (low, high) = base.inputs[entry.name], entry.range
    is_number = entry.role == "frame_index"
    count = entry.frames or 0
    if is_number:
        numbers = math.floor(high) - math.ceil(low) + 1
        count = min(numbers, entry.frames or numbers)
    # Of more frames than are run, every n-th is, with the first and the last.
    tested = min(count, _MAX_FRAMES)
    for step in range(tested):
        frame = step * (count - 1) // max(tested - 1, 1)
        number = math.ceil(low) + frame if is_number else frame
        value = number if is_number else entry.time_of_frame(frame)
        array = cast_array(np.full(template.shape, float(value)), template.dtype.name)
        yield _moment(f"frame {number}", base, {entry.name: array})


def _screen_moments(manifest: GeneratorManifest, base: Probe) -> Iterator[Probe]:
    """Yield the base camera with a picture that is wide, and with one that is tall."""
    order = manifest.space.matrix_order if manifest.space else "column"
    for words, (width, height) in _VIEWPORTS.items():
        lens = as_tensor(perspective(_FIELD_OF_VIEW, width / height, *_PLANES), order)
        values = {"projection": lens, "viewport": np.array([width, height])}
        inputs = {
            entry.name: cast_array(values[entry.role], base.inputs[entry.name].dtype.name)
            for entry in manifest.inputs
            if entry.role in values
        }
        if inputs:
            moment = _moment(f"in {words}, {width:g} × {height:g}", base, inputs)
            yield replace(moment, pictured=True)


def _picture_moments(
    manifest: GeneratorManifest | PostProcessManifest, base: Probe
) -> Iterator[Probe]:
    """Yield black, white and structured pictures of the base probe's size."""
    for entry in manifest.inputs:
        template = base.inputs[entry.name]
        if entry.role == "image" and template.ndim == 4:
            low, high = _picture_range(manifest, entry)
            for words, pattern in test_patterns(template.shape).items():
                values = cast_array(low + (high - low) * pattern, template.dtype.name)
                is_generator = isinstance(manifest, GeneratorManifest)
                yield _moment(words, base, {entry.name: values}, survey=is_generator)


def _picture_range(manifest: Manifest, entry: Input) -> tuple[float, float]:
    if isinstance(manifest, PostProcessManifest):
        return manifest.image_range
    return entry.range or (0.0, 1.0)


def _size_moments(
    manifest: PostProcessManifest, base: Probe, open_axes: dict[int, int]
) -> Iterator[Probe]:
    """Yield pictures of sizes that no power of two divides, along open axes."""
    images = [entry for entry in manifest.inputs if entry.role == "image"]
    if not open_axes or any(base.inputs[entry.name].ndim != 4 for entry in images):
        return
    for number, size in enumerate(_OPEN_SIZES):
        inputs = {}
        for entry in images:
            template = base.inputs[entry.name]
            shape = tuple(
                size[open_axes[axis]] if axis in open_axes else dim
                for axis, dim in enumerate(template.shape)
            )
            low, high = manifest.image_range
            pattern = synthetic_pictures(shape, np.random.default_rng([number]))
            inputs[entry.name] = cast_array(low + (high - low) * pattern, template.dtype.name)
        yield _moment(f"a picture of {shape[3]} × {shape[2]}", base, inputs, survey=False)


def _corner_moments(manifest: PostProcessManifest, base: Probe) -> Iterator[Probe]:
    ranged_inputs = ranged_inputs_of(manifest)
    numbers = sum(base.inputs[entry.name].size for entry in ranged_inputs)
    for number in range(min(_MAX_CORNERS, 2**numbers) if numbers else 0):
        inputs = corner_inputs(ranged_inputs, base, number)
        yield _moment(f"corner {number} of the ranges", base, inputs, survey=False)


def _history_moments(manifest: TrajectoryManifest, base: Probe) -> Iterator[Probe]:
    """Yield paths that turn about y and pass through half a turn, where w = 0, or go beyond it."""
    state = STATE_SIZES[manifest.outputs.future.representation]
    for entry in manifest.inputs:
        history = base.inputs[entry.name]
        if entry.role != "camera_history" or history.shape[1:] != (state,):
            continue
        for words, angle in (("at half a turn", np.pi), ("beyond half a turn", np.pi + _TURN_STEP)):
            newest = np.array([np.cos(angle / 2), 0, np.sin(angle / 2), 0])
            path = turning_path(history, np.array([0, _TURN_STEP, 0]), newest)
            yield _moment(f"a path that turns {words}", base, {entry.name: path}, survey=False)
