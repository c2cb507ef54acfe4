"""Writes a synthetic body model in the layout of SMPL and SMPL-X: tubes around a stick figure.

Only the order and the parents of the joints come from SMPL.
"""

__all__ = ["PersonOptions", "body_arrays", "clothing_colors", "write_body"]

import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from gsgen.sdk.math.skinning import NO_PARENT_JOINT

_SMPL_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
# The parent of jaw and eyes is the head; each wrist has five fingers of three joints.
_FINGER_SEGMENTS = tuple(
    wrist if joint % 3 == 0 else first + joint - 1
    for wrist, first in ((20, 25), (21, 40))
    for joint in range(15)
)
_JOINT_PARENTS = {24: _SMPL_PARENTS, 55: (*_SMPL_PARENTS[:22], 15, 15, 15, *_FINGER_SEGMENTS)}
# Offset of each joint from its parent: a stick figure of 1.7 m, y up, arms apart.
_BONE_TABLE = (
    *((0, 0, 0), (0.09, -0.09, 0), (-0.09, -0.09, 0), (0, 0.12, 0)),
    *((0.02, -0.4, 0), (-0.02, -0.4, 0), (0, 0.14, 0), (0, -0.42, -0.02), (0, -0.42, -0.02)),
    *((0, 0.06, 0), (0.02, -0.06, 0.13), (-0.02, -0.06, 0.13), (0, 0.21, 0)),
    *((0.08, 0.12, 0), (-0.08, 0.12, 0), (0, 0.12, 0.03), (0.11, 0.03, 0), (-0.11, 0.03, 0)),
    *((0.26, 0, 0), (-0.26, 0, 0), (0.25, 0, 0), (-0.25, 0, 0)),
)
_PALM_OFFSETS = ((0.08, 0, 0), (-0.08, 0, 0))
_FACE_POINTS = ((0, 0, 0.05), (0.03, 0.06, 0.07), (-0.03, 0.06, 0.07))
_HEAD_JOINT = 15
_CROWN_OFFSET = (0.0, 0.13, 0.02)  # top of the head, from its joint
# Radius of the tube that ends at a joint, in metres; the head's tube begins at its joint.
_BONE_RADII = (
    *(0.12, 0.1, 0.1, 0.12, 0.075, 0.075, 0.12, 0.055, 0.055, 0.13, 0.045, 0.045, 0.07),
    *(0.09, 0.09, 0.095, 0.075, 0.075, 0.05, 0.05, 0.04, 0.04),
)
_PALM_RADIUS, _FINGER_RADIUS = 0.03, 0.012
# Garment → joints whose tubes it covers; skin elsewhere.
_CLOTHING_BY_JOINT = {
    "shirt": (0, 3, 6, 9, 13, 14, 16, 17, 18, 19),
    "trousers": (1, 2, 4, 5, 7, 8),
    "shoes": (10, 11),
}
_CLOTHING_COLORS = {
    "skin": (0.85, 0.6, 0.46),
    "shirt": (0.16, 0.45, 0.68),
    "trousers": (0.76, 0.66, 0.45),
    "shoes": (0.6, 0.13, 0.12),
    "hair": (0.23, 0.12, 0.06),
}
_SKINNING_FALLOFF = 0.06  # metres over which a bone's skinning weight falls off


@dataclass(frozen=True, slots=True, kw_only=True)
class PersonOptions:
    """Options of a synthetic checkpoint of a person's avatar."""

    count: int = 60  # number of Gaussians
    kind: str = "smpl"  # ``smpl`` or ``smplx``
    vertices: int = 150  # number of vertices of the body model
    shapes: int = 10  # number of its shape coefficients
    nets: bool = False  # networks correct joints and weights (GauHuman's ``motion_offset_flag``)
    hands: bool = False  # the body model of SMPL-X has a mean pose of the hands
    degree: int = 3  # degree of the spherical harmonics
    npz: bool = False  # The body model is an ``.npz``, not a ``.pkl``. SMPL-X always is.
    width: int = 16  # width of the networks; 128 in the published code
    # cells of R3-Avatar's planes along x, y, z and t
    resolution: tuple[int, int, int, int] = (6, 5, 7, 8)
    channels: int = 4  # channels of each plane
    seed: int = 0  # seed of all noise

    @property
    def joints(self) -> int:
        """The number of joints of the synthetic body model."""
        return 24 if self.kind == "smpl" else 55


def body_arrays(options: PersonOptions) -> dict[str, np.ndarray]:
    """Return the arrays of a synthetic body model, named as in SMPL files."""
    rng = np.random.default_rng([options.seed, 1])
    count, joints = options.vertices, options.joints
    joint_positions = _joint_positions(joints)
    # The first vertices surround one joint each, so that the joint is their mean.
    tube = np.concatenate([np.arange(joints), _choose_tubes(joint_positions, count - joints, rng)])
    # Most others are on the tube to the parent and do not define a joint.
    is_surface_point = (np.arange(count) >= joints) & (rng.random(count) < 0.8)
    inner_points = joint_positions[tube] + rng.normal(0, 0.03, (count, 3))
    template = np.where(
        is_surface_point[:, None], _tube_points(joint_positions, tube, rng), inner_points
    )
    weights = np.exp(-((_bone_distances(template, joint_positions) / _SKINNING_FALLOFF) ** 2))
    weights[weights < 0.02 * weights.max(axis=1, keepdims=True)] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    regressor = ((tube[None] == np.arange(joints)[:, None]) & ~is_surface_point).astype(float)
    regressor /= regressor.sum(axis=1, keepdims=True)
    table = np.array([_JOINT_PARENTS[joints], range(joints)], np.int64) % (NO_PARENT_JOINT + 1)
    scaled_joints = np.einsum("vi,ijk->vjk", template, rng.normal(0, 0.02, (3, 3, options.shapes)))
    arrays = {
        "v_template": template,
        "shapedirs": scaled_joints + rng.normal(0, 0.001, scaled_joints.shape),
        "posedirs": rng.normal(0, 0.001, (count, 3, 9 * (joints - 1))),
        "weights": weights,
        "J_regressor": regressor,
        "kintree_table": table.astype(np.uint32),
    }
    if options.hands:
        arrays["hands_meanl"], arrays["hands_meanr"] = rng.normal(0, 0.3, (2, 45))
    return {
        name: value if value.dtype.kind == "u" else value.astype(np.float32)
        for name, value in arrays.items()
    }


def _joint_positions(joints: int) -> Float[np.ndarray, "j 3"]:
    bones = _BONE_TABLE + (_PALM_OFFSETS if joints == 24 else _FACE_POINTS)
    positions = np.zeros((joints, 3))
    for joint, parent in enumerate(_JOINT_PARENTS[joints][1:], start=1):
        if joint < len(bones):
            bone = np.array(bones[joint])
        else:  # fingers point away from the body, side by side
            finger_number = (joint - len(bones)) // 3 % 5
            length = 0.08 if joint % 3 == len(bones) % 3 else 0.03
            bone = np.array([length if joint < 40 else -length, 0, 0.015 * (finger_number - 2)])
        positions[joint] = positions[parent] + bone
    return positions


def _body_tubes(
    joint_positions: Float[np.ndarray, "j 3"],
) -> tuple[Float[np.ndarray, "j 3"], Float[np.ndarray, "j 3"], Float[np.ndarray, " j"]]:
    """Return begin, end and radius of the tube (limb) around each bone of the stick figure."""
    tube_start = joint_positions[np.maximum(np.array(_JOINT_PARENTS[len(joint_positions)]), 0)]
    end = joint_positions.copy()
    tube_start[_HEAD_JOINT], end[_HEAD_JOINT] = (
        joint_positions[_HEAD_JOINT],
        joint_positions[_HEAD_JOINT] + _CROWN_OFFSET,
    )
    extra_joints = len(joint_positions) - len(_BONE_RADII)
    radius = np.array(
        [
            *_BONE_RADII,
            *[_PALM_RADIUS if extra_joints == len(_PALM_OFFSETS) else _FINGER_RADIUS]
            * extra_joints,
        ]
    )
    return tube_start, end, radius


def _choose_tubes(
    joint_positions: Float[np.ndarray, "j 3"], count: int, rng: np.random.Generator
) -> Int[np.ndarray, " n"]:
    """Choose random limbs (tubes) of the synthetic body, in proportion to their surface."""
    tube_start, end, radius = _body_tubes(joint_positions)
    surface = radius * (np.linalg.norm(end - tube_start, axis=1) + 0.3 * radius)
    return rng.choice(len(joint_positions), count, p=surface / surface.sum())


def _tube_points(
    joint_positions: Float[np.ndarray, "j 3"], tube: Int[np.ndarray, " n"], rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Sample random points on the surface of the limbs (tubes) of a synthetic body."""
    tube_start, end, radius = (values[tube] for values in _body_tubes(joint_positions))
    segment = end - tube_start
    length = np.linalg.norm(segment, axis=1, keepdims=True)
    axis = segment / np.maximum(length, 1e-9)
    direction = rng.normal(size=(len(tube), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    fraction = rng.random((len(tube), 1))
    # The ends are round: there the normal keeps its component along the bone.
    is_cap_point = (fraction < 0.2) & ((direction * axis).sum(axis=1, keepdims=True) < 0)
    is_cap_point |= (fraction > 0.8) & ((direction * axis).sum(axis=1, keepdims=True) > 0)
    perpendicular = direction - (direction * axis).sum(axis=1, keepdims=True) * axis
    perpendicular /= np.maximum(np.linalg.norm(perpendicular, axis=1, keepdims=True), 1e-9)
    fraction = np.where(is_cap_point, np.round(fraction), fraction)
    points: Float[np.ndarray, "n 3"] = (
        tube_start
        + fraction * segment
        + radius[:, None] * np.where(is_cap_point, direction, perpendicular)
    )
    return points


def _bone_distances(
    points: Float[np.ndarray, "n 3"], joint_positions: Float[np.ndarray, "j 3"]
) -> Float[np.ndarray, "n j"]:
    """Return the distances from points to the bones that begin at each joint."""
    distance: Float[np.ndarray, "n j"] = np.linalg.norm(
        points[:, None] - joint_positions[None], axis=2
    )
    for child, parent in enumerate(_JOINT_PARENTS[len(joint_positions)]):
        if parent >= 0:
            distances = _segment_distance(points, joint_positions[parent], joint_positions[child])
            distance[:, parent] = np.minimum(distance[:, parent], distances)
    head_crown_distance = _segment_distance(
        points, joint_positions[_HEAD_JOINT], joint_positions[_HEAD_JOINT] + _CROWN_OFFSET
    )
    distance[:, _HEAD_JOINT] = np.minimum(distance[:, _HEAD_JOINT], head_crown_distance)
    return distance


def _segment_distance(
    points: Float[np.ndarray, "n 3"],
    tube_start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
) -> Float[np.ndarray, " n"]:
    segment = end - tube_start
    fraction = np.clip((points - tube_start) @ segment / max(segment @ segment, 1e-12), 0, 1)
    distance: Float[np.ndarray, " n"] = np.linalg.norm(
        points - tube_start - fraction[:, None] * segment, axis=1
    )
    return distance


def clothing_colors(
    points: Float[np.ndarray, "n 3"], options: PersonOptions
) -> Float[np.ndarray, "n 3"]:
    """Return colours in [0, 1] for points around a body: skin, hair and clothes, lit from above."""
    joint_positions = _joint_positions(options.joints)
    tube_start, end, radius = _body_tubes(joint_positions)
    distance = np.stack(
        [
            _segment_distance(points, *end_points) - tube_radius
            for *end_points, tube_radius in zip(tube_start, end, radius, strict=True)
        ],
        axis=1,
    )
    tube = distance.argmin(axis=1)
    worn_colors = np.tile(_CLOTHING_COLORS["skin"], (options.joints, 1))
    for name, tubes in _CLOTHING_BY_JOINT.items():
        worn_colors[list(tubes)] = _CLOTHING_COLORS[name]
    colors = worn_colors[tube]
    head = points - joint_positions[_HEAD_JOINT]
    hair = (tube == _HEAD_JOINT) & (head[:, 1] - 0.8 * head[:, 2] > 0.1)
    colors[hair] = _CLOTHING_COLORS["hair"]
    tube_center = tube_start[tube] + 0.5 * (end - tube_start)[tube]
    brightness = np.clip((points - tube_center)[:, 1:] @ [0.6, 0.8] / radius[tube], -1, 1)
    lit_colors: Float[np.ndarray, "n 3"] = np.clip(
        colors * (0.85 + 0.3 * brightness[:, None]), 0, 1
    )
    return lit_colors


def write_body(path: Path, options: PersonOptions = PersonOptions()) -> Path:
    """Write a synthetic body model as ``.pkl`` or ``.npz``, by the suffix, and return the path."""
    from scipy.sparse import csc_matrix

    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = dict(body_arrays(options))
    if path.suffix == ".npz":
        np.savez(path, **arrays)
        return path
    arrays["J_regressor"] = csc_matrix(arrays["J_regressor"])
    arrays |= {"bs_style": "lbs", "bs_type": "lrotmin"}
    path.write_bytes(pickle.dumps(arrays, protocol=2))
    return path
