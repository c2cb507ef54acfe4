"""Reads LHM avatars that a fork of LHM for the Visionary web viewer saves at inference.

LHM itself saves no Gaussians. The fork's ``runners/infer/human_lrm.py`` saves a list, which
``torch.load(weights_only=True)`` reads: offsets, query points, colours, opacities, scales,
quaternions, joint transforms to the neutral pose, shape coefficients, a ratio and a flag for the
face. A Gaussian's skinning weights are those of the vertex nearest to its sample point. The sample
points and the list of vertices that must not rotate come with LHM's weights.
"""

__all__ = ["Face", "LHMCheckpoint", "read_face", "read_lhm"]

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gsgen.formats import read_ply_columns
from gsgen.reference_plugins.bodies.body_models import Body, read_body, required_body
from gsgen.reference_plugins.loading.array_archives import read_npy, read_npz
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, format_faults
from gsgen.reference_plugins.loading.folder import likely_folders, required_file
from gsgen.reference_plugins.loading.tensor_files import load_tensors

JOINTS = 55
SHAPE_BETA_COUNT = 10
# Index of the first expression in a full SMPL-X file, and the number of those that LHM uses.
FIRST_EXPRESSION = 300
EXPRESSIONS = 100
_TENSOR_NAMES = (
    "offset_xyz", "query_points", "rgb", "opacity", "scaling", "rotation",
    "transform_mat_neutral_pose", "betas", "body_ratio", "have_face",
)  # fmt: skip
_POINTS_FOLDER = "pretrained_models/dense_sample_points"
_PRIOR_FILE = "pretrained_models/voxel_grid/human_prior_constrain.npz"


@dataclass(frozen=True, slots=True, kw_only=True)
class LHMCheckpoint:
    """An avatar of LHM: Gaussians, body shape of the person, and body model."""

    path: Path  # the file of tensors
    position: Float[Tensor, "n 3"]  # query points and their offsets, added
    rgb: Float[Tensor, "n 3"]  # colours in [0, 1]
    opacity: Float[Tensor, "n 1"]  # opacities in [0, 1]
    scale: Float[Tensor, "n 3"]  # linear standard deviations
    rotation: Float[Tensor, "n 4"]  # quaternions (w, x, y, z)
    # joint transforms from the pose of the query points to the neutral pose
    neutral: Float[Tensor, "j 4 4"]
    betas: Float[Tensor, " s"]  # shape coefficients of the person
    # sample points on the body, one for each Gaussian, in the same order
    samples: Float[np.ndarray, "n 3"]
    stiff: Bool[np.ndarray, " v"]  # mask of the vertices whose Gaussians do not rotate
    body: Body  # the body model

    def describe(self) -> str:
        """Describe an avatar of LHM in one line: Gaussians and body model."""
        return f"{self.path}: {len(self.position):,} Gaussians; {self.body.describe()}"


@dataclass(frozen=True, slots=True)
class Face:
    """Facial expressions of FLAME, which LHM uses in place of those of SMPL-X."""

    vertices: Int[np.ndarray, " f"]  # indices of the SMPL-X vertices that they move
    dirs: Float[np.ndarray, "f 3 e"]  # offset of each vertex per expression coefficient


def read_lhm(folder: Path, body: Path | None = None) -> LHMCheckpoint:
    """Read an LHM avatar from a file that LHM's inference code saved.

    ``folder`` holds the ``.pth`` and ``pretrained_models``, or is the ``.pth`` beside them. Without
    ``body``, the SMPL-X file is searched there.
    """
    path = _avatar_file(folder)
    avatar_folder = path.parent
    tensors = _tensors(path)
    candidates = {"beside": avatar_folder / "SMPLX_NEUTRAL.npz"}
    candidates["models"] = (
        avatar_folder / "pretrained_models/human_model_files/smplx/SMPLX_NEUTRAL.npz"
    )
    model = read_body(required_body(body, candidates, JOINTS), JOINTS)
    if model.shape_dirs.shape[2] < FIRST_EXPRESSION + EXPRESSIONS:
        message = f"has {model.shape_dirs.shape[2]} shape coefficients, expected 400"
        hint = "Give the file of 300 shapes and 100 expressions (SMPLX_NEUTRAL.npz, v1.1)."
        raise CheckpointInvalid(message, where=str(model.path), hint=hint)
    count = len(tensors["offset_xyz"])
    return LHMCheckpoint(
        path=path,
        position=tensors["query_points"] + tensors["offset_xyz"],
        rgb=tensors["rgb"],
        opacity=tensors["opacity"],
        scale=tensors["scaling"],
        rotation=tensors["rotation"],
        neutral=tensors["transform_mat_neutral_pose"],
        betas=tensors["betas"],
        samples=_read_samples(avatar_folder / _POINTS_FOLDER, count),
        stiff=_rigid_vertices(avatar_folder / _PRIOR_FILE, len(model.template)),
        body=model,
    )


def read_face(flame: Path, ids: Path, body: Body) -> Face:
    """Read the facial expressions of FLAME and the SMPL-X vertices that they move.

    ``flame`` is ``FLAME_NEUTRAL.pkl`` or an ``.npz`` of the same arrays, and ``ids`` is
    ``SMPL-X__FLAME_vertex_ids.npy``.
    """
    required_file(flame, "FLAME, from https://flame.is.tue.mpg.de after registration")
    required_file(ids, "SMPL-X__FLAME_vertex_ids.npy, which comes with SMPL-X")
    dirs = np.asarray(_face_dirs(flame))
    vertices = read_npy(ids)
    last_expression = FIRST_EXPRESSION + EXPRESSIONS
    if dirs.ndim != 3 or dirs.shape[1] != 3 or dirs.shape[2] < last_expression:
        message = f"shapedirs is {list(dirs.shape)}, expected [5023, 3, 400]"
        raise CheckpointInvalid(message, where=str(flame))
    whole = vertices.ndim == 1 and vertices.dtype.kind in "iu"
    if not whole or len(vertices) != len(dirs) or vertices.max() >= len(body.template):
        message = (
            f"holds {vertices.dtype} {list(vertices.shape)}, expected {len(dirs)} vertex indices"
        )
        raise CheckpointInvalid(message, where=str(ids))
    expressions = dirs[:, :, FIRST_EXPRESSION:last_expression].astype(np.float64)
    return Face(vertices.astype(np.int64), expressions)


def _face_dirs(path: Path) -> Any:
    read = (read_npz if path.suffix == ".npz" else read_array_pickle)(path, ("shapedirs",))
    if "shapedirs" not in read:
        raise CheckpointInvalid("has no array shapedirs, the vertex offsets", where=str(path))
    return read["shapedirs"]


def _avatar_file(folder: Path) -> Path:
    if folder.is_file():
        return folder
    if not folder.is_dir():
        raise CheckpointInvalid("does not exist: expected a file or a folder", where=str(folder))
    files = sorted(folder.glob("*.pth"))
    if len(files) != 1:
        names = ", ".join(path.name for path in files) or "no file"
        hint = "Give the file itself, or a folder with exactly one .pth file."
        nearby_files = (
            "" if files else likely_folders(folder, lambda candidate: any(candidate.glob("*.pth")))
        )
        message = f"holds {len(files)} .pth files ({names}), expected one"
        raise CheckpointInvalid(message, where=str(folder), hint=nearby_files or hint)
    return files[0]


def _tensors(path: Path) -> dict[str, Tensor]:
    hint = f"Expected the list {', '.join(_TENSOR_NAMES)}, as Visionary's fork of LHM saves it."
    read = load_tensors(path, hint)
    if not isinstance(read, list | tuple) or len(read) != len(_TENSOR_NAMES):
        actual = f"a {type(read).__name__}"
        if isinstance(read, list | tuple):
            actual = f"{len(read)} values"
        message = f"holds {actual}, expected {len(_TENSOR_NAMES)} values"
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    fields = dict(zip(_TENSOR_NAMES, read, strict=True))
    first = fields["offset_xyz"]
    # LHM squeezes tensors before saving: those of a single Gaussian have no rows.
    count = first.numel() // 3 if isinstance(first, Tensor) else 0
    expected = {
        "offset_xyz": (count, 3),
        "query_points": (count, 3),
        "rgb": (count, 3),
        "opacity": (count, 1),
        "scaling": (count, 3),
        "rotation": (count, 4),
        "transform_mat_neutral_pose": (JOINTS, 4, 4),
        "betas": (SHAPE_BETA_COUNT,),
    }
    tensors = {}
    for name, shape in expected.items():
        value = fields[name]
        if not isinstance(value, Tensor) or not count:
            raise CheckpointInvalid(
                f"the field {name} is not a tensor with rows", where=str(path), hint=hint
            )
        if value.numel() != np.prod(shape) or not torch.isfinite(value).all():
            message = f"{name} is {list(value.shape)}, expected {list(shape)}, all finite"
            raise CheckpointInvalid(message, where=str(path), hint=hint)
        tensors[name] = value.detach().to(torch.float32).reshape(shape)
    return tensors


def _read_samples(folder: Path, count: int) -> Float[np.ndarray, "n 3"]:
    hint = "Copy pretrained_models/dense_sample_points, which comes with LHM's weights, to here."
    names = sorted(folder.glob("*.ply")) if folder.is_dir() else []
    if not names:
        raise CheckpointInvalid("holds no .ply file", where=str(folder), hint=hint)
    for path in names:
        points = _read_points(path)
        if len(points) == count:
            return points
    message = f"holds no .ply file of {count} points ({', '.join(path.name for path in names)})"
    raise CheckpointInvalid(message, where=str(folder), hint=hint)


def _read_points(path: Path) -> Float[np.ndarray, "n 3"]:
    with format_faults(path):
        return read_ply_columns(path, {"position": ("x", "y", "z")})["position"].astype(np.float64)


def _rigid_vertices(path: Path, vertices: int) -> Bool[np.ndarray, " v"]:
    required_file(path, "the vertices that do not rotate; it comes with LHM's weights")
    masks = read_npz(path, ("masks",)).get("masks", np.zeros(0))
    if masks.shape != (vertices,):
        message = f"masks is {list(masks.shape)}, expected [{vertices}]"
        raise CheckpointInvalid(message, where=str(path))
    return np.asarray(masks > 0)
