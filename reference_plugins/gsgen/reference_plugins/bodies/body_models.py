"""Reads the body models SMPL, SMPL-X and FLAME from the files that their authors distribute.

All require registration and must not be redistributed, so gsgen contains no part of them. A file
is identified by the shapes of its arrays (Loper et al. 2015, "SMPL"; Pavlakos et al. 2019,
"Expressive Body Capture").
"""

__all__ = ["Body", "joints_of_file", "read_body", "read_parents", "required_body"]

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from gsgen.reference_plugins.loading.array_archives import read_npz
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.sdk.math.skinning import NO_PARENT_JOINT

# Number of joints → name and website of the body model.
BODY_FILES = {
    5: ("FLAME", "https://flame.is.tue.mpg.de"),
    24: ("SMPL", "https://smpl.is.tue.mpg.de"),
    55: ("SMPL-X", "https://smpl-x.is.tue.mpg.de"),
}
_REQUIRED_ARRAYS = (
    "v_template",
    "shapedirs",
    "posedirs",
    "weights",
    "J_regressor",
    "kintree_table",
)
_HAND_MEANS = ("hands_meanl", "hands_meanr")
_FACES_KEY = "f"


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """A skinned body model of V vertices and J joints, in float64."""

    path: Path
    template: Float[np.ndarray, "v 3"]  # vertices of the rest pose, [V, 3]
    shape_dirs: Float[np.ndarray, "v 3 s"]  # vertex offsets per shape coefficient, [V, 3, S]
    # vertex offsets per entry of the joints' R − I without the root, [V, 3, 9(J−1)]
    pose_dirs: Float[np.ndarray, "v 3 p"]
    weights: Float[np.ndarray, "v j"]  # skinning weight of each joint for each vertex, [V, J]
    regressor: Float[np.ndarray, "j v"]  # matrix from vertices to joint positions, [J, V]
    parents: tuple[int, ...]  # the parent of each joint; −1 for the root
    # mean pose of both hands in SMPL-X, [90], if the file has one
    hand_mean: Float[np.ndarray, "90"] | None = None
    # triangles as vertices, counted from 0; empty if the file has none
    faces: Int[np.ndarray, "f 3"] = field(default_factory=lambda: np.zeros((0, 3), np.int64))

    @property
    def joints(self) -> int:
        """The number of joints of the body model."""
        return len(self.parents)

    @property
    def kind(self) -> str:
        """The name of the body model: SMPL or SMPL-X."""
        return BODY_FILES[self.joints][0]

    def describe(self) -> str:
        """Describe the body model in one line: file, kind and sizes."""
        return (
            f"{self.path}: {self.kind} of {len(self.template):,} vertices, {self.joints} joints "
            f"and {self.shape_dirs.shape[2]} shape coefficients"
        )


def required_body(requested_file: Path | None, candidates: Mapping[str, Path], joints: int) -> Path:
    """Return the path of a body model: the requested file, or else the first existing candidate.

    ``candidates`` maps a label to the path at which the training code looks for the file. The hint
    of the error tells where to download it.
    """
    for path in (requested_file,) if requested_file is not None else candidates.values():
        if path.is_file():
            return path
    name, file_name = BODY_FILES[joints]
    searched_paths = ", ".join(str(path) for path in candidates.values()) or "nowhere else"
    where = str(requested_file) if requested_file is not None else "--body"
    message = f"the body model {name} is missing" + (
        "" if requested_file else f" (searched: {searched_paths})"
    )
    suffix = ".pkl or .npz" if joints == 24 else ".npz"
    raise CheckpointInvalid(
        message,
        where=where,
        hint=f"Register at {file_name}, accept the licence, download the model and give it: "
        f"--body {name.replace('-', '')}_NEUTRAL{suffix}. Expected {', '.join(_REQUIRED_ARRAYS)} of "
        f"{joints} joints. Its licence forbids redistribution, so gsgen cannot download it.",
    )


def read_body(path: Path, joints: int) -> Body:
    """Read a body model with a given number of joints from a ``.pkl`` or ``.npz``."""
    required_body(path, {}, joints)
    read = _read_arrays(path)
    missing = [name for name in _REQUIRED_ARRAYS if name not in read]
    if missing:
        hint = (
            f"Expected {', '.join(_REQUIRED_ARRAYS)}, as in the file from {BODY_FILES[joints][1]}."
        )
        raise CheckpointInvalid(f"lacks {', '.join(missing)}", where=str(path), hint=hint)
    arrays = {name: _require_numbers(path, name, read[name]) for name in _REQUIRED_ARRAYS}
    _check_shapes(path, arrays, joints)
    hands = [
        _require_numbers(path, name, read[name]).ravel() for name in _HAND_MEANS if name in read
    ]
    hand_mean_pose = np.concatenate(hands) if len(hands) == 2 else None
    if hand_mean_pose is not None and hand_mean_pose.shape != (90,):
        message = f"hands_meanl and hands_meanr hold {hand_mean_pose.size} numbers, expected 90"
        raise CheckpointInvalid(message, where=str(path))
    faces = (
        _require_numbers(path, _FACES_KEY, read[_FACES_KEY])
        if _FACES_KEY in read
        else np.zeros((0, 3))
    )
    if (
        faces.ndim != 2
        or faces.shape[1] != 3
        or not _are_indices_within(faces, len(arrays["v_template"]))
    ):
        message = (
            f"{_FACES_KEY} is {list(faces.shape)}, expected triangles of the vertices, [faces, 3]"
        )
        raise CheckpointInvalid(message, where=str(path))
    return Body(
        path=path,
        template=arrays["v_template"],
        shape_dirs=arrays["shapedirs"],
        pose_dirs=arrays["posedirs"],
        weights=arrays["weights"],
        regressor=arrays["J_regressor"],
        parents=read_parents(path, "kintree_table", arrays["kintree_table"][0]),
        hand_mean=hand_mean_pose,
        faces=faces.astype(np.int64),
    )


def _are_indices_within(indices: Float[np.ndarray, "f 3"], count: int) -> bool:
    return bool(((indices >= 0) & (indices < count)).all())


def joints_of_file(path: Path) -> int:
    """Return the number of joints of the body model in a file; 0 without a kintree_table."""
    shape = np.shape(_read_arrays(path).get("kintree_table", ()))
    return int(shape[-1]) if shape else 0


def _read_arrays(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        is_zipped = file.read(4) == b"PK\x03\x04"
    # Read the known arrays only: the published files also hold other objects.
    return (read_npz if is_zipped else read_array_pickle)(
        path, (*_REQUIRED_ARRAYS, *_HAND_MEANS, _FACES_KEY)
    )


def _require_numbers(path: Path, name: str, value: Any) -> Float[np.ndarray, "..."]:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        message = f"{name} holds {array.dtype}, expected numbers"
        raise CheckpointInvalid(message, where=str(path))
    numbers = array.astype(np.float64)
    if not np.isfinite(numbers).all():
        raise CheckpointInvalid(f"{name} holds NaN or infinity", where=str(path))
    return numbers


def _check_shapes(path: Path, arrays: Mapping[str, np.ndarray], joints: int) -> None:
    vertices = len(arrays["v_template"])
    shapes = arrays["shapedirs"].shape[2] if arrays["shapedirs"].ndim == 3 else 1
    expected = {
        "v_template": (vertices, 3),
        "shapedirs": (vertices, 3, shapes),
        "posedirs": (vertices, 3, 9 * (joints - 1)),
        "weights": (vertices, joints),
        "J_regressor": (joints, vertices),
        "kintree_table": (2, joints),
    }
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            actual = list(arrays[name].shape)
            hint = f"Give the {BODY_FILES[joints][0]} model, from {BODY_FILES[joints][1]}."
            message = f"{name} is {actual}, expected {list(shape)}"
            raise CheckpointInvalid(message, where=str(path), hint=hint)


def read_parents(path: Path, name: str, table: Float[np.ndarray, " j"]) -> tuple[int, ...]:
    """Return the parent of each joint, −1 for the root, of an array called ``name`` in a file."""
    parents = [-1 if p in (-1, NO_PARENT_JOINT) else int(p) for p in table]
    for joint, parent in enumerate(parents):
        if not (parent == -1 if joint == 0 else 0 <= parent < joint):
            message = f"{name} gives joint {joint} the parent {parent}"
            hint = "Expected the root first, and every parent before its children."
            raise CheckpointInvalid(message, where=str(path), hint=hint)
    return tuple(parents)
