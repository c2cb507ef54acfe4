"""Reads checkpoints of GaussianAvatars: a 3DGS PLY bound to triangles, and FLAME's parameters.

The layout is that of ShenhanQian/GaussianAvatars, ``scene/flame_gaussian_model.py``:
``flame_param.npz`` beside the PLY has the shape of the head and offsets of its vertices.
"""

__all__ = ["GaussianAvatarsCheckpoint", "read_gaussian_avatars"]

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int

from gsgen.formats import ply_properties, read_ply_columns
from gsgen.reference_plugins.bodies.body_models import Body, read_body, required_body
from gsgen.reference_plugins.heads.teeth import SHAPE_COUNT, TEETH_VERTEX_COUNT, add_teeth
from gsgen.reference_plugins.loading.array_archives import read_npz
from gsgen.reference_plugins.loading.canonical import Canonical
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, format_faults
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.training_run import TrainingRun, open_run

_JOINT_COUNT = 5
_SH_REST_PATTERN = re.compile(r"f_rest_\d+")
_FLAME_FILES = ("flame2023.pkl", "flame2023_no_jaw.pkl", "generic_model.pkl")


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianAvatarsCheckpoint:
    """The Gaussians of a GaussianAvatars checkpoint, their triangles, and the head."""

    run: TrainingRun
    canonical: Canonical  # in the frames of their triangles
    binding: Int[np.ndarray, " n"]  # the triangle of each Gaussian
    body: Body  # FLAME, with teeth if the training had them
    shape: Float[np.ndarray, " s"]  # shape coefficients of the head
    offset: Float[np.ndarray, "v 3"]  # static offsets of the vertices
    expressions: int  # number of expression coefficients

    def describe(self) -> str:
        """Return the sizes of the avatar and of its face model as one line."""
        return (
            f"{self.run}, {self.canonical.describe()} on {len(np.unique(self.binding)):,} triangles, "
            f"{self.expressions} expressions; {self.body.describe()}"
        )


def read_gaussian_avatars(
    folder: Path, iteration: int | None = None, body: Path | None = None
) -> GaussianAvatarsCheckpoint:
    """Read a GaussianAvatars checkpoint, and FLAME from ``body`` or the run's folder ``assets``."""
    run = open_run("gaussian-avatars", folder, iteration)
    canonical, binding = _read_bound_gaussians(run.files / "point_cloud.ply")
    path = run.files / "flame_param.npz"
    required_file(path, "the parameters of FLAME")
    names = ("shape", "expr", "static_offset")
    arrays = read_npz(path, names)
    for name in names:
        kind = arrays[name].dtype.kind if name in arrays else ""
        if kind not in "fiu" or not kind or not np.isfinite(arrays[name]).all():
            message = f"{name} is missing, or holds other values than finite numbers"
            raise CheckpointInvalid(message, where=str(path))
    candidates = {name: run.folder / "assets" / name for name in _FLAME_FILES}
    flame = read_body(required_body(body, candidates, _JOINT_COUNT), _JOINT_COUNT)
    offset = arrays["static_offset"].astype(np.float64)
    offset = offset[0] if offset.ndim == 3 and len(offset) == 1 else offset
    if offset.shape == (len(flame.template) + TEETH_VERTEX_COUNT, 3):
        flame = add_teeth(flame)
    shape = arrays["shape"].astype(np.float64).ravel()
    expression_basis = arrays["expr"]
    expressions = expression_basis.shape[1] if expression_basis.ndim == 2 else 0
    stored_shapes = flame.shape_dirs.shape[2]
    if offset.shape != (len(flame.template), 3):
        message = (
            f"static_offset is {list(offset.shape)}, but FLAME has {len(flame.template)} vertices"
        )
        hint = "Give the FLAME model that the training used: --body FILE."
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    if not expressions or len(shape) > SHAPE_COUNT or stored_shapes < SHAPE_COUNT + expressions:
        raise CheckpointInvalid(
            f"has {len(shape)} shapes and {expressions} expressions; expected at most {SHAPE_COUNT} "
            f"shapes and 1 to {max(0, stored_shapes - SHAPE_COUNT)} expressions, as FLAME has",
            where=str(path),
        )
    if binding.min() < 0 or binding.max() >= len(flame.faces):
        message = f"binding_0 names triangle {binding.max()}, but FLAME has {len(flame.faces)}"
        raise CheckpointInvalid(message, where=str(run.files / "point_cloud.ply"))
    return GaussianAvatarsCheckpoint(
        run=run,
        canonical=canonical,
        binding=binding,
        body=flame,
        shape=shape,
        offset=offset,
        expressions=expressions,
    )


def _read_bound_gaussians(path: Path) -> tuple[Canonical, Int[np.ndarray, " n"]]:
    """Read PLY splats bound to mesh triangles; plain PLY readers refuse such files."""
    required_file(path, "the Gaussians")
    with format_faults(path):
        rest_count = sum(1 for name in ply_properties(path) if _SH_REST_PATTERN.fullmatch(name))
        groups = {
            "position": ["x", "y", "z"],
            "dc": [f"f_dc_{i}" for i in range(3)],
            "rest": [f"f_rest_{i}" for i in range(rest_count)],
            "opacity": ["opacity"],
            "scale": [f"scale_{i}" for i in range(3)],
            "rotation": [f"rot_{i}" for i in range(4)],
            "binding": ["binding_0"],
        }
        tables = read_ply_columns(path, groups)
    if rest_count not in (0, 9, 24, 45):
        message = f"has {rest_count} properties f_rest_N, expected 0, 9, 24 or 45"
        raise CheckpointInvalid(message, where=str(path))
    binding = tables["binding"][:, 0]
    if not (binding == np.rint(binding)).all():
        raise CheckpointInvalid("binding_0 holds fractions, expected integers", where=str(path))
    count = len(binding)
    sh = np.concatenate(
        [tables["dc"][:, None], tables["rest"].reshape(count, 3, -1).transpose(0, 2, 1)], axis=1
    )
    canonical = Canonical(
        position=torch.from_numpy(tables["position"]),
        rotation=torch.from_numpy(tables["rotation"]),
        log_scale=torch.from_numpy(tables["scale"]),
        logit_opacity=torch.from_numpy(tables["opacity"]),
        sh=torch.from_numpy(sh),
    )
    return canonical, binding.astype(np.int64)
