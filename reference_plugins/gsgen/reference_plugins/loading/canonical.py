"""The Gaussians that a deformation starts from: a 3DGS PLY, as tensors."""

__all__ = ["Canonical", "read_canonical"]

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE, coefficients
from gsgen.formats import FormatError, PointCloud, read_ply
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file


@dataclass(frozen=True, slots=True)
class Canonical:
    """N Gaussians before activation, float32.

    Attributes:
        position: Centres.
        rotation: Quaternions (w, x, y, z), not normalised.
        log_scale: Logarithms of the standard deviations.
        logit_opacity: Opacity before the sigmoid.
        sh: Spherical harmonics, coefficient by coefficient.
        stored: The degree in the file, where ``sh`` was cut to what renderers draw.
    """

    position: Float[Tensor, "n 3"]
    rotation: Float[Tensor, "n 4"]
    log_scale: Float[Tensor, "n 3"]
    logit_opacity: Float[Tensor, "n 1"]
    sh: Float[Tensor, "n k 3"]
    stored: int | None = None

    def __len__(self) -> int:
        return self.position.shape[0]

    @property
    def degree(self) -> int:
        """Of the spherical harmonics."""
        return math.isqrt(self.sh.shape[1]) - 1

    def describe(self) -> str:
        """Say in a few words what it is."""
        cut = "" if self.stored is None else f" (cut from {self.stored})"
        return f"{len(self):,} Gaussians of SH degree {self.degree}{cut}"


def read_canonical(path: Path) -> Canonical:
    """Read the 3DGS PLY at ``path``.

    Raises:
        CheckpointInvalid: It is missing, or holds no splats.
    """
    required_file(path, "the canonical Gaussians")
    try:
        read = read_ply(path)
    except FormatError as error:
        what = str(error).replace(f"{path}: ", "")
        raise CheckpointInvalid(what, where=str(path)) from error
    if isinstance(read, PointCloud):
        raise CheckpointInvalid("holds points, wanted splats", where=str(path))
    return Canonical(
        torch.from_numpy(read.position),
        torch.from_numpy(read.rotation),
        torch.from_numpy(read.log_scale),
        torch.from_numpy(read.logit_opacity)[:, None],
        torch.from_numpy(read.sh[:, : coefficients(MAX_DEGREE)]),
        read.degree if read.degree > MAX_DEGREE else None,
    )
