"""A body model in the layout of SMPL and SMPL-X, made of tubes around the bones of a stick figure.

Nothing in it comes from SMPL but the order of its joints and which hangs on which.
"""

__all__ = ["PersonOptions", "arrays_of", "colors_of", "write_body"]

import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

_SMPL = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
# Jaw and eyes hang on the head; five fingers of three joints on each wrist.
_FINGERS = tuple(
    wrist if joint % 3 == 0 else first + joint - 1
    for wrist, first in ((20, 25), (21, 40))
    for joint in range(15)
)
_PARENTS = {24: _SMPL, 55: (*_SMPL[:22], 15, 15, 15, *_FINGERS)}
# Where each joint of root and body is, from its parent: a stick figure of 1.7 m, y up, arms apart.
_BONES = (
    *((0, 0, 0), (0.09, -0.09, 0), (-0.09, -0.09, 0), (0, 0.12, 0)),
    *(
        (0.02, -0.4, 0),
        (-0.02, -0.4, 0),
        (0, 0.14, 0),
        (0, -0.42, -0.02),
        (0, -0.42, -0.02),
    ),
    *((0, 0.06, 0), (0.02, -0.06, 0.13), (-0.02, -0.06, 0.13), (0, 0.21, 0)),
    *(
        (0.08, 0.12, 0),
        (-0.08, 0.12, 0),
        (0, 0.12, 0.03),
        (0.11, 0.03, 0),
        (-0.11, 0.03, 0),
    ),
    *((0.26, 0, 0), (-0.26, 0, 0), (0.25, 0, 0), (-0.25, 0, 0)),
)
_PALMS = ((0.08, 0, 0), (-0.08, 0, 0))
_FACE = ((0, 0, 0.05), (0.03, 0.06, 0.07), (-0.03, 0.06, 0.07))
_HEAD = 15
_CROWN = (0.0, 0.13, 0.02)  # where the head ends, from its joint
# How thick the tube is that ends in a joint, in metres; the head's is the one that begins there.
_RADIUS = (
    *(0.12, 0.1, 0.1, 0.12, 0.075, 0.075, 0.12, 0.055, 0.055, 0.13, 0.045, 0.045, 0.07),
    *(0.09, 0.09, 0.095, 0.075, 0.075, 0.05, 0.05, 0.04, 0.04),
)
_PALM, _FINGER = 0.03, 0.012
# The joint whose tube a vertex is on → what it wears; skin elsewhere.
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
_NO_PARENT = 0xFFFFFFFF
_REACH = 0.06  # metres over which a bone's hold on the skin falls


@dataclass(frozen=True, slots=True)
class PersonOptions:
    """What a training run may choose.

    Attributes:
        count: Gaussians.
        kind: ``smpl`` or ``smplx``.
        vertices: Of the body model.
        shapes: Its shape coefficients.
        nets: Joints and weights are corrected by networks (GauHuman's ``motion_offset_flag``).
        hands: The body model of SMPL-X has a mean pose of the hands.
        degree: Of the spherical harmonics.
        npz: The body model is an ``.npz``; a ``.pkl`` otherwise. SMPL-X always is.
        width: Of the networks; 128 in the published code.
        resolution: Cells of R3-Avatar's planes along x, y, z and t.
        channels: Of each plane.
        seed: Of all noise.
    """

    count: int = 60
    kind: str = "smpl"
    vertices: int = 150
    shapes: int = 10
    nets: bool = False
    hands: bool = False
    degree: int = 3
    npz: bool = False
    width: int = 16
    resolution: tuple[int, int, int, int] = (6, 5, 7, 8)
    channels: int = 4
    seed: int = 0

    @property
    def joints(self) -> int:
        """Of the body model."""
        return 24 if self.kind == "smpl" else 55


def arrays_of(options: PersonOptions) -> dict[str, np.ndarray]:
    """Return the arrays of a body model, named as its files name them."""
    rng = np.random.default_rng([options.seed, 1])
    count, joints = options.vertices, options.joints
    places = _places(joints)
    # Every joint has vertices around it, from which it can be had back.
    tube = np.concatenate([np.arange(joints), _chosen_tubes(places, count - joints, rng)])
    # Most others lie on the tube to the parent, and say nothing of the joint.
    outside = (np.arange(count) >= joints) & (rng.random(count) < 0.8)
    inside = places[tube] + rng.normal(0, 0.03, (count, 3))
    template = np.where(outside[:, None], _on_tubes(places, tube, rng), inside)
    weights = np.exp(-((_away(template, places) / _REACH) ** 2))
    weights[weights < 0.02 * weights.max(axis=1, keepdims=True)] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    regressor = ((tube[None] == np.arange(joints)[:, None]) & ~outside).astype(float)
    regressor /= regressor.sum(axis=1, keepdims=True)
    table = np.array([_PARENTS[joints], range(joints)], np.int64) % (_NO_PARENT + 1)
    grown = np.einsum("vi,ijk->vjk", template, rng.normal(0, 0.02, (3, 3, options.shapes)))
    made = {
        "v_template": template,
        "shapedirs": grown + rng.normal(0, 0.001, grown.shape),
        "posedirs": rng.normal(0, 0.001, (count, 3, 9 * (joints - 1))),
        "weights": weights,
        "J_regressor": regressor,
        "kintree_table": table.astype(np.uint32),
    }
    if options.hands:
        made["hands_meanl"], made["hands_meanr"] = rng.normal(0, 0.3, (2, 45))
    return {
        name: value if value.dtype.kind == "u" else value.astype(np.float32)
        for name, value in made.items()
    }


def _places(joints: int) -> Float[np.ndarray, "j 3"]:
    """Return where the joints are."""
    bones = _BONES + (_PALMS if joints == 24 else _FACE)
    places = np.zeros((joints, 3))
    for joint, parent in enumerate(_PARENTS[joints][1:], start=1):
        if joint < len(bones):
            bone = np.array(bones[joint])
        else:  # fingers: away from the body, side by side
            finger = (joint - len(bones)) // 3 % 5
            away = 0.08 if joint % 3 == len(bones) % 3 else 0.03
            bone = np.array([away if joint < 40 else -away, 0, 0.015 * (finger - 2)])
        places[joint] = places[parent] + bone
    return places


def _tubes(
    places: Float[np.ndarray, "j 3"],
) -> tuple[Float[np.ndarray, "j 3"], Float[np.ndarray, "j 3"], Float[np.ndarray, " j"]]:
    """Return where the tube of each joint begins and ends, and how thick it is."""
    begin = places[np.maximum(np.array(_PARENTS[len(places)]), 0)]
    end = places.copy()
    begin[_HEAD], end[_HEAD] = places[_HEAD], places[_HEAD] + _CROWN
    others = len(places) - len(_RADIUS)
    radius = np.array([*_RADIUS, *[_PALM if others == len(_PALMS) else _FINGER] * others])
    return begin, end, radius


def _chosen_tubes(
    places: Float[np.ndarray, "j 3"], count: int, rng: np.random.Generator
) -> Int[np.ndarray, " n"]:
    """Return tubes, each as often as its surface is large, and every joint's at times."""
    begin, end, radius = _tubes(places)
    surface = radius * (np.linalg.norm(end - begin, axis=1) + 0.3 * radius)
    return rng.choice(len(places), count, p=surface / surface.sum())


def _on_tubes(
    places: Float[np.ndarray, "j 3"], tube: Int[np.ndarray, " n"], rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Return points on the tubes: across the bone, at its radius."""
    begin, end, radius = (one[tube] for one in _tubes(places))
    along = end - begin
    length = np.linalg.norm(along, axis=1, keepdims=True)
    axis = along / np.maximum(length, 1e-9)
    out = rng.normal(size=(len(tube), 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    share = rng.random((len(tube), 1))
    # Ends are round: there the way out keeps what it has along the bone.
    ended = (share < 0.2) & ((out * axis).sum(axis=1, keepdims=True) < 0)
    ended |= (share > 0.8) & ((out * axis).sum(axis=1, keepdims=True) > 0)
    flat = out - (out * axis).sum(axis=1, keepdims=True) * axis
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    share = np.where(ended, np.round(share), share)
    made: Float[np.ndarray, "n 3"] = (
        begin + share * along + radius[:, None] * np.where(ended, out, flat)
    )
    return made


def _away(
    points: Float[np.ndarray, "n 3"], places: Float[np.ndarray, "j 3"]
) -> Float[np.ndarray, "n j"]:
    """Return how far points are from the bones that each joint turns: those that begin there."""
    away: Float[np.ndarray, "n j"] = np.linalg.norm(points[:, None] - places[None], axis=2)
    for child, parent in enumerate(_PARENTS[len(places)]):
        if parent >= 0:
            near = _from_bone(points, places[parent], places[child])
            away[:, parent] = np.minimum(away[:, parent], near)
    crown = _from_bone(points, places[_HEAD], places[_HEAD] + _CROWN)
    away[:, _HEAD] = np.minimum(away[:, _HEAD], crown)
    return away


def _from_bone(
    points: Float[np.ndarray, "n 3"],
    begin: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
) -> Float[np.ndarray, " n"]:
    along = end - begin
    share = np.clip((points - begin) @ along / max(along @ along, 1e-12), 0, 1)
    made: Float[np.ndarray, " n"] = np.linalg.norm(
        points - begin - share[:, None] * along, axis=1
    )
    return made


def colors_of(
    points: Float[np.ndarray, "n 3"], options: PersonOptions
) -> Float[np.ndarray, "n 3"]:
    """Return what a body wears at points around it, lighter above than below, in [0, 1]."""
    places = _places(options.joints)
    begin, end, radius = _tubes(places)
    away = np.stack(
        [
            _from_bone(points, *ends) - thick
            for *ends, thick in zip(begin, end, radius, strict=True)
        ],
        axis=1,
    )
    tube = away.argmin(axis=1)
    worn = np.tile(_COLORS["skin"], (options.joints, 1))
    for name, tubes in _CLOTHES.items():
        worn[list(tubes)] = _COLORS[name]
    colors = worn[tube]
    head = points - places[_HEAD]
    hair = (tube == _HEAD) & (head[:, 1] - 0.8 * head[:, 2] > 0.1)
    colors[hair] = _COLORS["hair"]
    middle = begin[tube] + 0.5 * (end - begin)[tube]
    light = np.clip((points - middle)[:, 1:] @ [0.6, 0.8] / radius[tube], -1, 1)
    made: Float[np.ndarray, "n 3"] = np.clip(colors * (0.85 + 0.3 * light[:, None]), 0, 1)
    return made


def write_body(path: Path, options: PersonOptions = PersonOptions()) -> Path:
    """Write a body model, ``.pkl`` or ``.npz`` as the name says, and return ``path``."""
    from scipy.sparse import csc_matrix

    path.parent.mkdir(parents=True, exist_ok=True)
    made: dict[str, Any] = dict(arrays_of(options))
    if path.suffix == ".npz":
        np.savez(path, **made)
        return path
    made["J_regressor"] = csc_matrix(made["J_regressor"])
    made |= {"bs_style": "lbs", "bs_type": "lrotmin"}
    path.write_bytes(pickle.dumps(made, protocol=2))
    return path
