"""Test inputs that survey a scene: cameras in and around it, other inputs at range ends.

Cameras of other probes orbit outside the bounds, and their inputs lie on one line through the
ranges. These stand inside the scene, far away and on twenty sides, and combine the ends of ranges.
The sandbox keeps the extremes of their outputs alone, so that a probe costs little more than a run.
"""

__all__ = ["SIDE_LABEL", "survey_probes"]

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.probes import (
    ORBIT,
    Array,
    CameraPlacement,
    Probe,
    Surroundings,
    as_tensor,
)
from gsgen.contract.spec.fields.roles import CAMERA_ROLES, ROTATION_ROLES
from gsgen.contract.spec.geometry import look_at
from gsgen.contract.spec.manifest import GeneratorManifest, Input

# Start of the label of a camera outside the bounds that looks at their centre.
SIDE_LABEL = "from side"
# Distance of the farthest camera, in half diagonals: twenty diagonals.
_FAR = 40.0
# Distances of the cameras on the twenty sides, in half diagonals; None stands for inside, at this
# share of the half extents.
_DISTANCES = (ORBIT, 1.1, None)
_WITHIN = 0.6
# Combinations of range ends for models without a camera.
_CORNERS = 8
_GOLDEN = (1 + 5**0.5) / 2
# The sides: vertices of a regular dodecahedron, of which eight are the diagonals of a cube.
_SIDES = np.array(
    [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    + [
        np.roll([0, a / _GOLDEN, b * _GOLDEN], turn)
        for turn in range(3)
        for a in (-1, 1)
        for b in (-1, 1)
    ]
) / np.sqrt(3)
_SEED = 20


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
    others = [entry for entry in manifest.inputs if entry.role not in CAMERA_ROLES]
    ranged = [entry for entry in others if entry.range is not None]
    cameras = [entry for entry in manifest.inputs if entry.role in ("view", "camera_position")]
    if any(map(manifest.depends, cameras)):
        yield from list(_viewed(manifest, ranged, first))[:limit]
    elif sum(first[1].inputs[entry.name].size for entry in ranged) > 1:
        for number in range(min(_CORNERS, limit)):
            inputs = first[1].inputs | _corner(ranged, first[1], number)
            yield _survey(f"corner {number} of the ranges", inputs)


def _survey(label: str, inputs: dict[str, Array]) -> Probe:
    return Probe(label=label, inputs=inputs, extra=True, survey=True)


def _viewed(
    manifest: GeneratorManifest, ranged: list[Input], first: tuple[Probe, ...]
) -> Iterator[Probe]:
    """Yield the model's test inputs for each camera in and around the scene."""
    scene, base = Surroundings.of(manifest), first[1]
    forward = np.roll(scene.up, 1)
    inside = _camera_at(scene.center, forward, scene.up)
    middle = _survey("from the middle", base.inputs | _camera_inputs(manifest, base, inside))
    yield middle
    rows = manifest.outputs.gaussians
    if rows is not None:
        placement = CameraPlacement(
            rows=rows.name,
            order=manifest.space.matrix_order if manifest.space else "column",
            view=_name_of(manifest, "view"),
            position=_name_of(manifest, "camera_position"),
        )
        yield replace(middle, label="from the centre of a Gaussian", placement=placement)
    away = _camera_at(scene.center - _FAR * scene.radius * forward, forward, scene.up)
    yield _survey("from 20 diagonals", base.inputs | _camera_inputs(manifest, base, away))
    for number, side in enumerate(_SIDES):
        distance = _DISTANCES[number % len(_DISTANCES)]
        reach = _WITHIN * scene.half if distance is None else distance * scene.radius
        view = _camera_at(scene.center + reach * side, -side, scene.up)
        other = first[1 + number % (len(first) - 1)]
        inputs = other.inputs | _camera_inputs(manifest, other, view)
        words = SIDE_LABEL if distance is not None else "from within, side"
        yield _survey(f"{words} {number}", inputs | _corner(ranged, other, number))


def _camera_at(
    eye: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"], up: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "4 4"]:
    """Return the view matrix of a camera at a point that looks in a direction."""
    view = look_at(np.zeros(3), direction, up)
    view[:3, 3] = -view[:3, :3] @ eye
    return view


def _name_of(manifest: GeneratorManifest, role: str) -> str:
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


def _corner(ranged: list[Input], base: Probe, number: int) -> dict[str, Array]:
    """Return test inputs with each number at a random end of its range; ``number`` is the seed."""
    rng = np.random.default_rng([_SEED, number])
    inputs = {}
    for entry in ranged:
        assert entry.range is not None
        like = base.inputs[entry.name]
        if entry.role in ROTATION_ROLES and (like.shape[-1] == 4 or like.shape == (3, 3)):
            continue  # ends of ranges form no quaternion and no rotation matrix
        ends = np.where(rng.random(like.shape) < 0.5, *entry.range)
        if like.dtype.kind == "f":
            limits = np.finfo(like.dtype)
            ends = np.clip(ends, limits.min, limits.max)
        inputs[entry.name] = np.asarray(ends).astype(like.dtype)
    return inputs
