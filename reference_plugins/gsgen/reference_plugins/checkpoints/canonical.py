"""The Gaussians that a deformation starts from: a 3DGS PLY, as tensors."""

__all__ = ["Canonical", "read_canonical"]

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.formats import FormatError, PointCloud, read_ply
from gsgen.reference_plugins.checkpoints.errors import CheckpointInvalid
from gsgen.reference_plugins.checkpoints.folder import required_file


@dataclass(frozen=True, slots=True)
class Canonical:
    """N Gaussians before activation, float32.

    Attributes:
        position: Centres.
        rotation: Quaternions (w, x, y, z), not normalised.
        log_scale: Logarithms of the standard deviations.
        logit_opacity: Opacity before the sigmoid.
        sh: Spherical harmonics, coefficient by coefficient.
    """

    position: Float[Tensor, "n 3"]
    rotation: Float[Tensor, "n 4"]
    log_scale: Float[Tensor, "n 3"]
    logit_opacity: Float[Tensor, "n 1"]
    sh: Float[Tensor, "n k 3"]

    def __len__(self) -> int:
        return self.position.shape[0]

    @property
    def degree(self) -> int:
        """Of the spherical harmonics."""
        return math.isqrt(self.sh.shape[1]) - 1


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
        torch.from_numpy(read.sh),
    )
