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

from gsgen.sdk.math.skinning import NO_PARENT

_SMPL = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
# The parent of jaw and eyes is the head; each wrist has five fingers of three joints.
_FINGERS = tuple(
    wrist if joint % 3 == 0 else first + joint - 1
    for wrist, first in ((20, 25), (21, 40))
    for joint in range(15)
)
_PARENTS = {24: _SMPL, 55: (*_SMPL[:22], 15, 15, 15, *_FINGERS)}
# Offset of each joint from its parent: a stick figure of 1.7 m, y up, arms apart.
_BONES = (
    *((0, 0, 0), (0.09, -0.09, 0), (-0.09, -0.09, 0), (0, 0.12, 0)),
    *((0.02, -0.4, 0), (-0.02, -0.4, 0), (0, 0.14, 0), (0, -0.42, -0.02), (0, -0.42, -0.02)),
    *((0, 0.06, 0), (0.02, -0.06, 0.13), (-0.02, -0.06, 0.13), (0, 0.21, 0)),
    *((0.08, 0.12, 0), (-0.08, 0.12, 0), (0, 0.12, 0.03), (0.11, 0.03, 0), (-0.11, 0.03, 0)),
    *((0.26, 0, 0), (-0.26, 0, 0), (0.25, 0, 0), (-0.25, 0, 0)),
)
_PALMS = ((0.08, 0, 0), (-0.08, 0, 0))
_FACE = ((0, 0, 0.05), (0.03, 0.06, 0.07), (-0.03, 0.06, 0.07))
_HEAD = 15
_CROWN = (0.0, 0.13, 0.02)  # top of the head, from its joint
# Radius of the tube that ends at a joint, in metres; the head's tube begins at its joint.
_RADIUS = (
    *(0.12, 0.1, 0.1, 0.12, 0.075, 0.075, 0.12, 0.055, 0.055, 0.13, 0.045, 0.045, 0.07),
    *(0.09, 0.09, 0.095, 0.075, 0.075, 0.05, 0.05, 0.04, 0.04),
)
_PALM, _FINGER = 0.03, 0.012
# Garment → joints whose tubes it covers; skin elsewhere.
_CLOTHES = {
    "shirt": (0, 3, 6, 9, 13, 14, 16, 17, 18, 19),
    "trousers": (1, 2, 4, 5, 7, 8),
    "shoes": (10, 11),
}
_COLORS = {
    "skin": (0.85, 0.6, 0.46),
    "shirt": (0.16, 0.45, 0.68),
    "trousers": (0.76, 0.66, 0.45),
    "shoes": (0.6, 0.13, 0.12),
    "hair": (0.23, 0.12, 0.06),
}
_REACH = 0.06  # metres over which a bone's skinning weight falls off


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
    tube = np.concatenate([np.arange(joints), _chosen_tubes(joint_positions, count - joints, rng)])
    # Most others are on the tube to the parent and do not define a joint.
    outside = (np.arange(count) >= joints) & (rng.random(count) < 0.8)
    inside = joint_positions[tube] + rng.normal(0, 0.03, (count, 3))
    template = np.where(outside[:, None], _tube_points(joint_positions, tube, rng), inside)
    weights = np.exp(-((_bone_distances(template, joint_positions) / _REACH) ** 2))
    weights[weights < 0.02 * weights.max(axis=1, keepdims=True)] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    regressor = ((tube[None] == np.arange(joints)[:, None]) & ~outside).astype(float)
    regressor /= regressor.sum(axis=1, keepdims=True)
    table = np.array([_PARENTS[joints], range(joints)], np.int64) % (NO_PARENT + 1)
    grown = np.einsum("vi,ijk->vjk", template, rng.normal(0, 0.02, (3, 3, options.shapes)))
    arrays = {
        "v_template": template,
        "shapedirs": grown + rng.normal(0, 0.001, grown.shape),
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
    bones = _BONES + (_PALMS if joints == 24 else _FACE)
    positions = np.zeros((joints, 3))
    for joint, parent in enumerate(_PARENTS[joints][1:], start=1):
        if joint < len(bones):
            bone = np.array(bones[joint])
        else:  # fingers point away from the body, side by side
            finger = (joint - len(bones)) // 3 % 5
            length = 0.08 if joint % 3 == len(bones) % 3 else 0.03
            bone = np.array([length if joint < 40 else -length, 0, 0.015 * (finger - 2)])
        positions[joint] = positions[parent] + bone
    return positions


def _tubes(
    joint_positions: Float[np.ndarray, "j 3"],
) -> tuple[Float[np.ndarray, "j 3"], Float[np.ndarray, "j 3"], Float[np.ndarray, " j"]]:
    """Return begin, end and radius of the tube (limb) around each bone of the stick figure."""
    begin = joint_positions[np.maximum(np.array(_PARENTS[len(joint_positions)]), 0)]
    end = joint_positions.copy()
    begin[_HEAD], end[_HEAD] = joint_positions[_HEAD], joint_positions[_HEAD] + _CROWN
    extra_joints = len(joint_positions) - len(_RADIUS)
    radius = np.array(
        [*_RADIUS, *[_PALM if extra_joints == len(_PALMS) else _FINGER] * extra_joints]
    )
    return begin, end, radius


def _chosen_tubes(
    joint_positions: Float[np.ndarray, "j 3"], count: int, rng: np.random.Generator
) -> Int[np.ndarray, " n"]:
    """Choose random limbs (tubes) of the synthetic body, in proportion to their surface."""
    begin, end, radius = _tubes(joint_positions)
    surface = radius * (np.linalg.norm(end - begin, axis=1) + 0.3 * radius)
    return rng.choice(len(joint_positions), count, p=surface / surface.sum())


def _tube_points(
    joint_positions: Float[np.ndarray, "j 3"], tube: Int[np.ndarray, " n"], rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Sample random points on the surface of the limbs (tubes) of a synthetic body."""
    begin, end, radius = (values[tube] for values in _tubes(joint_positions))
    along = end - begin
    length = np.linalg.norm(along, axis=1, keepdims=True)
    axis = along / np.maximum(length, 1e-9)
    out = rng.normal(size=(len(tube), 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    share = rng.random((len(tube), 1))
    # The ends are round: there the normal keeps its component along the bone.
    ended = (share < 0.2) & ((out * axis).sum(axis=1, keepdims=True) < 0)
    ended |= (share > 0.8) & ((out * axis).sum(axis=1, keepdims=True) > 0)
    flat = out - (out * axis).sum(axis=1, keepdims=True) * axis
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    share = np.where(ended, np.round(share), share)
    points: Float[np.ndarray, "n 3"] = (
        begin + share * along + radius[:, None] * np.where(ended, out, flat)
    )
    return points


def _bone_distances(
    points: Float[np.ndarray, "n 3"], joint_positions: Float[np.ndarray, "j 3"]
) -> Float[np.ndarray, "n j"]:
    """Return the distances from points to the bones that begin at each joint."""
    distance: Float[np.ndarray, "n j"] = np.linalg.norm(
        points[:, None] - joint_positions[None], axis=2
    )
    for child, parent in enumerate(_PARENTS[len(joint_positions)]):
        if parent >= 0:
            near = _segment_distance(points, joint_positions[parent], joint_positions[child])
            distance[:, parent] = np.minimum(distance[:, parent], near)
    crown = _segment_distance(points, joint_positions[_HEAD], joint_positions[_HEAD] + _CROWN)
    distance[:, _HEAD] = np.minimum(distance[:, _HEAD], crown)
    return distance


def _segment_distance(
    points: Float[np.ndarray, "n 3"], begin: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]
) -> Float[np.ndarray, " n"]:
    along = end - begin
    share = np.clip((points - begin) @ along / max(along @ along, 1e-12), 0, 1)
    distance: Float[np.ndarray, " n"] = np.linalg.norm(
        points - begin - share[:, None] * along, axis=1
    )
    return distance


def clothing_colors(
    points: Float[np.ndarray, "n 3"], options: PersonOptions
) -> Float[np.ndarray, "n 3"]:
    """Return colours in [0, 1] for points around a body: skin, hair and clothes, lit from above."""
    joint_positions = _joint_positions(options.joints)
    begin, end, radius = _tubes(joint_positions)
    distance = np.stack(
        [
            _segment_distance(points, *ends) - thick
            for *ends, thick in zip(begin, end, radius, strict=True)
        ],
        axis=1,
    )
    tube = distance.argmin(axis=1)
    worn = np.tile(_COLORS["skin"], (options.joints, 1))
    for name, tubes in _CLOTHES.items():
        worn[list(tubes)] = _COLORS[name]
    colors = worn[tube]
    head = points - joint_positions[_HEAD]
    hair = (tube == _HEAD) & (head[:, 1] - 0.8 * head[:, 2] > 0.1)
    colors[hair] = _COLORS["hair"]
    middle = begin[tube] + 0.5 * (end - begin)[tube]
    light = np.clip((points - middle)[:, 1:] @ [0.6, 0.8] / radius[tube], -1, 1)
    lit_colors: Float[np.ndarray, "n 3"] = np.clip(colors * (0.85 + 0.3 * light[:, None]), 0, 1)
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
