"""Avatars of LHM, as the inference code of Visionary's fork saves them.

LHM itself keeps no Gaussians. The fork's ``runners/infer/human_lrm.py`` saves a list, which
``torch.load(weights_only=True)`` reads: offsets, query points, colours, opacities, scales,
quaternions, the transforms of the joints to the neutral pose, shape coefficients, a ratio and
whether there is a face. What a Gaussian hangs on follows from the vertex nearest to its sample
point, which comes with LHM's weights, as does the list of vertices that must not turn.
"""

__all__ = ["Face", "LHMCheckpoint", "read_face", "read_lhm"]

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gsgen.formats import FormatError, read_ply_columns
from gsgen.reference_plugins.bodies.body_models import Body, read_body, required_body
from gsgen.reference_plugins.loading.array_archives import read_npz
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import likely_folders, required_file
from gsgen.reference_plugins.loading.tensor_files import load_tensors

JOINTS = 55
BETAS = 10
# Where the expressions of a full SMPL-X file begin, and how many LHM takes of them.
FIRST_EXPRESSION = 300
EXPRESSIONS = 100
_FIELDS = (
    "offset_xyz",
    "query_points",
    "rgb",
    "opacity",
    "scaling",
    "rotation",
    "transform_mat_neutral_pose",
    "betas",
    "body_ratio",
    "have_face",
)
_POINTS = "pretrained_models/dense_sample_points"
_PRIOR = "pretrained_models/voxel_grid/human_prior_constrain.npz"


@dataclass(frozen=True, slots=True)
class LHMCheckpoint:
    """One avatar.

    Attributes:
        path: The file of tensors.
        position: Query points and their offsets, added.
        rgb: Colours in [0, 1].
        opacity: In [0, 1].
        scale: Linear standard deviations.
        rotation: Quaternions (w, x, y, z).
        neutral: Transforms of the joints from the pose of the query points to the neutral one.
        betas: Shape coefficients of the person.
        samples: Sample points on the body, one for each Gaussian, in the same order.
        stiff: Vertices whose Gaussians do not turn.
        body: The body model.
    """

    path: Path
    position: Float[Tensor, "n 3"]
    rgb: Float[Tensor, "n 3"]
    opacity: Float[Tensor, "n 1"]
    scale: Float[Tensor, "n 3"]
    rotation: Float[Tensor, "n 4"]
    neutral: Float[Tensor, "j 4 4"]
    betas: Float[Tensor, " s"]
    samples: Float[np.ndarray, "n 3"]
    stiff: Bool[np.ndarray, " v"]
    body: Body

    def describe(self) -> str:
        """Say in one line what it holds."""
        return f"{self.path}: {len(self.position):,} Gaussians; {self.body.describe()}"


@dataclass(frozen=True, slots=True)
class Face:
    """Expressions of FLAME, which LHM puts in the place of SMPL-X's.

    Attributes:
        vertices: Which vertices of SMPL-X they move.
        dirs: What each coefficient adds to them.
    """

    vertices: Int[np.ndarray, " f"]
    dirs: Float[np.ndarray, "f 3 e"]


def read_lhm(folder: Path, body: Path | None = None) -> LHMCheckpoint:
    """Read an avatar.

    Args:
        folder: What holds the ``.pth`` and ``pretrained_models``; or the ``.pth`` itself, with
            ``pretrained_models`` beside it.
        body: The SMPL-X file; looked for in the folder where absent.

    Raises:
        CheckpointInvalid: Something is missing, or does not fit the rest.
    """
    path = _avatar_file(folder)
    home = path.parent
    tensors = _tensors(path)
    places = {"beside": home / "SMPLX_NEUTRAL.npz"}
    places["models"] = home / "pretrained_models/human_model_files/smplx/SMPLX_NEUTRAL.npz"
    model = read_body(required_body(body, places, JOINTS), JOINTS)
    if model.shape_dirs.shape[2] < FIRST_EXPRESSION + EXPRESSIONS:
        what = f"has {model.shape_dirs.shape[2]} shape coefficients, wanted 400"
        hint = "Give the file of 300 shapes and 100 expressions (SMPLX_NEUTRAL.npz, v1.1)."
        raise CheckpointInvalid(what, where=str(model.path), hint=hint)
    count = len(tensors["offset_xyz"])
    return LHMCheckpoint(
        path,
        tensors["query_points"] + tensors["offset_xyz"],
        tensors["rgb"],
        tensors["opacity"],
        tensors["scaling"],
        tensors["rotation"],
        tensors["transform_mat_neutral_pose"],
        tensors["betas"],
        _samples(home / _POINTS, count),
        _stiff(home / _PRIOR, len(model.template)),
        model,
    )


def read_face(flame: Path, ids: Path, body: Body) -> Face:
    """Read FLAME's expressions and which vertices of SMPL-X they belong to.

    Args:
        flame: ``FLAME_NEUTRAL.pkl`` or an ``.npz`` of the same arrays.
        ids: ``SMPL-X__FLAME_vertex_ids.npy``.
        body: The body that they go to.

    Raises:
        CheckpointInvalid: A file is damaged, or they do not fit each other.
    """
    required_file(flame, "FLAME, from https://flame.is.tue.mpg.de after registration")
    required_file(ids, "SMPL-X__FLAME_vertex_ids.npy, which comes with SMPL-X")
    dirs = np.asarray(_face_dirs(flame))
    try:
        vertices = np.asarray(np.load(ids, allow_pickle=False))
    except (ValueError, OSError, EOFError) as error:
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(ids)) from error
    last = FIRST_EXPRESSION + EXPRESSIONS
    if dirs.ndim != 3 or dirs.shape[1] != 3 or dirs.shape[2] < last:
        what = f"shapedirs is {list(dirs.shape)}, wanted [5023, 3, 400]"
        raise CheckpointInvalid(what, where=str(flame))
    whole = vertices.ndim == 1 and vertices.dtype.kind in "iu"
    if not whole or len(vertices) != len(dirs) or vertices.max() >= len(body.template):
        what = f"holds {vertices.dtype} {list(vertices.shape)}, wanted {len(dirs)} vertex numbers"
        raise CheckpointInvalid(what, where=str(ids))
    taken = dirs[:, :, FIRST_EXPRESSION:last].astype(np.float64)
    return Face(vertices.astype(np.int64), taken)


def _face_dirs(path: Path) -> Any:
    if path.suffix != ".npz":
        read = read_array_pickle(path)
    else:
        read = read_npz(path, ("shapedirs",))
    if "shapedirs" not in read:
        raise CheckpointInvalid("lacks shapedirs", where=str(path))
    return read["shapedirs"]


def _avatar_file(folder: Path) -> Path:
    if folder.is_file():
        return folder
    if not folder.is_dir():
        raise CheckpointInvalid("is no file and no folder", where=str(folder))
    found = sorted(folder.glob("*.pth"))
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        hint = "Give the file itself, or a folder with one .pth in it."
        near = "" if found else likely_folders(folder, lambda one: any(one.glob("*.pth")))
        what = f"holds {len(found)} files .pth ({names})"
        raise CheckpointInvalid(what, where=str(folder), hint=near or hint)
    return found[0]


def _tensors(path: Path) -> dict[str, Tensor]:
    hint = f"Wanted the list {', '.join(_FIELDS)}, as Visionary's fork of LHM saves it."
    read = load_tensors(path, hint)
    if not isinstance(read, list | tuple) or len(read) != len(_FIELDS):
        seen = f"a {type(read).__name__}"
        if isinstance(read, list | tuple):
            seen = f"{len(read)} things"
        what = f"holds {seen}, wanted {len(_FIELDS)}"
        raise CheckpointInvalid(what, where=str(path), hint=hint)
    named = dict(zip(_FIELDS, read, strict=True))
    first = named["offset_xyz"]
    # Training squeezes what it saves: one Gaussian alone has no rows.
    count = first.numel() // 3 if isinstance(first, Tensor) else 0
    wanted = {
        "offset_xyz": (count, 3),
        "query_points": (count, 3),
        "rgb": (count, 3),
        "opacity": (count, 1),
        "scaling": (count, 3),
        "rotation": (count, 4),
        "transform_mat_neutral_pose": (JOINTS, 4, 4),
        "betas": (BETAS,),
    }
    made = {}
    for name, shape in wanted.items():
        value = named[name]
        if not isinstance(value, Tensor) or not count:
            raise CheckpointInvalid(f"{name} is no tensor", where=str(path), hint=hint)
        if value.numel() != np.prod(shape) or not torch.isfinite(value).all():
            what = f"{name} is {list(value.shape)}, wanted {list(shape)}, all finite"
            raise CheckpointInvalid(what, where=str(path), hint=hint)
        made[name] = value.detach().to(torch.float32).reshape(shape)
    return made


def _samples(folder: Path, count: int) -> Float[np.ndarray, "n 3"]:
    hint = "It comes with LHM's weights: copy pretrained_models/dense_sample_points beside them."
    names = sorted(folder.glob("*.ply")) if folder.is_dir() else []
    if not names:
        raise CheckpointInvalid("holds no .ply", where=str(folder), hint=hint)
    for path in names:
        points = _points(path)
        if len(points) == count:
            return points
    what = f"holds no .ply of {count} points ({', '.join(path.name for path in names)})"
    raise CheckpointInvalid(what, where=str(folder), hint=hint)


def _points(path: Path) -> Float[np.ndarray, "n 3"]:
    try:
        read = read_ply_columns(path, {"position": ("x", "y", "z")})
    except FormatError as error:
        what = str(error).replace(f"{path}: ", "")
        raise CheckpointInvalid(what, where=str(path)) from error
    return read["position"].astype(np.float64)


def _stiff(path: Path, vertices: int) -> Bool[np.ndarray, " v"]:
    required_file(path, "which vertices do not turn; it comes with LHM's weights")
    masks = read_npz(path, ("masks",)).get("masks", np.zeros(0))
    if masks.shape != (vertices,):
        what = f"masks is {list(masks.shape)}, wanted [{vertices}]"
        raise CheckpointInvalid(what, where=str(path))
    return np.asarray(masks > 0)
