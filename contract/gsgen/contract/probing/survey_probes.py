"""Test inputs that survey a scene: cameras in and around it, other inputs at range ends.

Cameras of other probes orbit outside the bounds, and their inputs lie on one line through the
ranges. These stand inside the scene, above and below it, far away and on twenty sides, and combine
the ends of ranges. The sandbox keeps rows of those outputs alone that look faulty, so that a probe
costs little more than a run.
"""

__all__ = ["SIDE_LABEL", "corner_inputs", "ranged_inputs_of", "survey_probes"]

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.probes import (
    ORBIT_RADII,
    Array,
    CameraPlacement,
    Probe,
    SceneExtent,
    as_tensor,
    cast_array,
)
from gsgen.contract.spec.fields.roles import CAMERA_ROLES, PICTURE_ROLES, ROTATION_ROLES
from gsgen.contract.spec.geometry import look_at
from gsgen.contract.spec.manifest import GeneratorManifest, Input, Manifest

# Start of the label of a camera outside the bounds that looks at their centre.
SIDE_LABEL = "from side"
# Distance of the farthest camera, in half diagonals: twenty diagonals.
_FAR_DISTANCE = 40.0
# Distances of the cameras on the twenty sides, in half diagonals; None stands for inside, at this
# share of the half extents.
_CAMERA_DISTANCES = (ORBIT_RADII, 1.1, None)
_INSIDE_FRACTION = 0.6
# Combinations of range ends for models without a camera.
_MAX_CORNERS = 8
# Up to so many numbers, all combinations of ends are taken in turn; of more, random ones.
_MAX_COUNTED_NUMBERS = 4
# The turn of a camera that has the scene at the rim of its picture, in radians.
_RIM_ANGLE = np.deg2rad(30.0)
_GOLDEN_RATIO = (1 + 5**0.5) / 2
# The sides: vertices of a regular dodecahedron, of which eight are the diagonals of a cube.
_SIDE_DIRECTIONS = np.array(
    [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    + [
        np.roll([0, a / _GOLDEN_RATIO, b * _GOLDEN_RATIO], axis_shift)
        for axis_shift in range(3)
        for a in (-1, 1)
        for b in (-1, 1)
    ]
) / np.sqrt(3)
_RANDOM_SEED = 20


def survey_probes(
    manifest: GeneratorManifest, first: tuple[Probe, ...], limit: int
) -> Iterator[Probe]:
    """Yield test inputs with cameras in and around a scene, cameras inside the scene first.

    Args:
        manifest: Declares the role and the range of each input.
        first: The probes of value rules, of which the first is all zeros.
        limit: The largest number of probes.
    """
    if len(first) < 2:
        return
    ranged_inputs = ranged_inputs_of(manifest)
    cameras = [entry for entry in manifest.inputs if entry.role in ("view", "camera_position")]
    if any(map(manifest.depends, cameras)):
        yield from list(_camera_survey_probes(manifest, ranged_inputs, first))[:limit]
    elif sum(first[1].inputs[entry.name].size for entry in ranged_inputs) > 1:
        for number in range(min(_MAX_CORNERS, limit)):
            inputs = first[1].inputs | corner_inputs(ranged_inputs, first[1], number)
            yield _survey_probe(f"corner {number} of the ranges", inputs)


def ranged_inputs_of(manifest: Manifest) -> list[Input]:
    """Return the inputs with a range, except cameras, and pictures, which ends do not form."""
    return [
        entry
        for entry in manifest.inputs
        if entry.range is not None and entry.role not in (*CAMERA_ROLES, *PICTURE_ROLES)
    ]


def _survey_probe(label: str, inputs: dict[str, Array]) -> Probe:
    return Probe(label=label, inputs=inputs, extra=True, survey=True, pictured=True)


def _camera_survey_probes(
    manifest: GeneratorManifest, ranged_inputs: list[Input], first: tuple[Probe, ...]
) -> Iterator[Probe]:
    """Yield the model's test inputs for each camera in and around the scene."""
    scene, base = SceneExtent.from_manifest(manifest), first[1]
    forward = np.roll(scene.up, 1)
    inner_view = _camera_at(scene.center, forward, scene.up)
    middle_probe = _survey_probe(
        "from the middle", base.inputs | _camera_inputs(manifest, base, inner_view)
    )
    yield middle_probe
    rows = manifest.outputs.gaussians
    if rows is not None:
        placement = CameraPlacement(
            rows=rows.name,
            order=manifest.space.matrix_order if manifest.space else "column",
            view=_input_name(manifest, "view"),
            position=_input_name(manifest, "camera_position"),
        )
        center_label = "from the centre of a Gaussian"
        yield replace(middle_probe, label=center_label, pictured=False, placement=placement)
    far_view = _camera_at(scene.center - _FAR_DISTANCE * scene.radius * forward, forward, scene.up)
    yield _survey_probe("from 20 diagonals", base.inputs | _camera_inputs(manifest, base, far_view))
    for words, up in (("above", scene.up), ("below", -scene.up)):
        pole_view = _camera_at(scene.center + ORBIT_RADII * scene.radius * up, -up, scene.up)
        yield _survey_probe(
            f"from {words}", base.inputs | _camera_inputs(manifest, base, pole_view)
        )
    rim_view = _camera_at(scene.center - scene.half * forward, forward, scene.up)
    yield _survey_probe("from the rim", base.inputs | _camera_inputs(manifest, base, rim_view))
    side = np.cross(scene.up, forward)
    direction = np.cos(_RIM_ANGLE) * forward + np.sin(_RIM_ANGLE) * side
    outer_view = _camera_at(
        scene.center - ORBIT_RADII * scene.radius * forward, direction, scene.up
    )
    yield _survey_probe(
        "with the scene at the picture's rim",
        base.inputs | _camera_inputs(manifest, base, outer_view),
    )
    for number, side in enumerate(_SIDE_DIRECTIONS):
        distance = _CAMERA_DISTANCES[number % len(_CAMERA_DISTANCES)]
        camera_distance = (
            _INSIDE_FRACTION * scene.half if distance is None else distance * scene.radius
        )
        view = _camera_at(scene.center + camera_distance * side, -side, scene.up)
        other = first[1 + number % (len(first) - 1)]
        inputs = other.inputs | _camera_inputs(manifest, other, view)
        words = SIDE_LABEL if distance is not None else "from within, side"
        yield _survey_probe(
            f"{words} {number}", inputs | corner_inputs(ranged_inputs, other, number)
        )


def _camera_at(
    eye: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"], up: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "4 4"]:
    """Return the view matrix of a camera at a point that looks in a direction."""
    view = look_at(np.zeros(3), direction, up)
    view[:3, 3] = -view[:3, :3] @ eye
    return view


def _input_name(manifest: GeneratorManifest, role: str) -> str:
    return next((entry.name for entry in manifest.inputs if entry.role == role), "")


def _camera_inputs(
    manifest: GeneratorManifest, base: Probe, view: Float[np.ndarray, "4 4"]
) -> dict[str, Array]:
    """Return the values of the inputs `view` and `camera_position` for a view matrix."""
    order = manifest.space.matrix_order if manifest.space else "column"
    center = -view[:3, :3].T @ view[:3, 3]
    arrays = {"view": as_tensor(view, order), "camera_position": center}
    return {
        entry.name: arrays[entry.role].astype(base.inputs[entry.name].dtype)
        for entry in manifest.inputs
        if entry.role in arrays
    }


def corner_inputs(ranged_inputs: list[Input], base: Probe, number: int) -> dict[str, Array]:
    """Return test inputs with each number at an end of its range.

    The bits of ``number`` say which end, where there are few numbers; else it is the seed.
    """
    rng = np.random.default_rng([_RANDOM_SEED, number])
    counted = sum(base.inputs[entry.name].size for entry in ranged_inputs) <= _MAX_COUNTED_NUMBERS
    first, inputs = 0, {}
    for entry in ranged_inputs:
        assert entry.range is not None
        template = base.inputs[entry.name]
        if entry.role in ROTATION_ROLES and (template.shape[-1] == 4 or template.shape == (3, 3)):
            continue  # ends of ranges form no quaternion and no rotation matrix
        bits = (number >> np.arange(first, first + template.size)) % 2
        is_low = bits.reshape(template.shape) == 0 if counted else rng.random(template.shape) < 0.5
        first += template.size
        ends = np.where(is_low, *entry.range)
        inputs[entry.name] = cast_array(ends, template.dtype.name)
    return inputs
