"""Reads canonical Gaussians, which a network deforms over time, from a 3DGS PLY."""

__all__ = ["Canonical", "read_canonical"]

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE, coefficients
from gsgen.formats import PointCloud, read_ply
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, format_faults
from gsgen.reference_plugins.loading.folder import required_file


@dataclass(frozen=True, slots=True, kw_only=True)
class Canonical:
    """N canonical (undeformed) Gaussians before activation, float32."""

    position: Float[Tensor, "n 3"]  # centres
    rotation: Float[Tensor, "n 4"]  # quaternions (w, x, y, z), not normalised
    log_scale: Float[Tensor, "n 3"]  # logarithms of the standard deviations
    logit_opacity: Float[Tensor, "n 1"]  # opacity before the sigmoid
    sh: Float[Tensor, "n k 3"]  # SH coefficients of red, green and blue
    # SH degree of the file, if ``sh`` was cut to the highest degree of renderers
    stored: int | None = None

    def __len__(self) -> int:
        return self.position.shape[0]

    @property
    def degree(self) -> int:
        """The degree of the spherical harmonics ``sh``."""
        return math.isqrt(self.sh.shape[1]) - 1

    def describe(self) -> str:
        """Return the number of canonical Gaussians and their SH degree as text."""
        cut_note = "" if self.stored is None else f" (cut from {self.stored})"
        return f"{len(self):,} Gaussians of SH degree {self.degree}{cut_note}"


def read_canonical(path: Path) -> Canonical:
    """Read the canonical (undeformed) Gaussians of a scene from a 3DGS PLY."""
    required_file(path, "the canonical Gaussians")
    with format_faults(path):
        splats = read_ply(path)
    if isinstance(splats, PointCloud):
        raise CheckpointInvalid("holds a point cloud, expected splats", where=str(path))
    return Canonical(
        position=torch.from_numpy(splats.position),
        rotation=torch.from_numpy(splats.rotation),
        log_scale=torch.from_numpy(splats.log_scale),
        logit_opacity=torch.from_numpy(splats.logit_opacity)[:, None],
        sh=torch.from_numpy(splats.sh[:, : coefficients(MAX_DEGREE)]),
        stored=splats.degree if splats.degree > MAX_DEGREE else None,
    )
