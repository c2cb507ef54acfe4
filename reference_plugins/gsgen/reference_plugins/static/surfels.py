"""Reads checkpoints of 2DGS: Gaussians on flat discs, which have two scales and a normal.

The layout is that of hbb1/2d-gaussian-splatting, commit 0faddba (``scene/gaussian_model.py``): a
3DGS PLY without ``scale_2``. The third axis of the rotation is the normal of the disc (Huang et al.
2024, "2D Gaussian Splatting for Geometrically Accurate Radiance Fields", section 4.1).
"""

__all__ = ["SurfelCheckpoint", "read_surfels"]

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gsgen.formats import Splats, ply_properties, read_ply_columns
from gsgen.formats.ply.layout import splat_degree, splat_groups
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, format_faults
from gsgen.reference_plugins.loading.training_run import TrainingRun, open_cloud

_SCALE_COLUMNS = ("scale_0", "scale_1")
_NORMAL_SCALE = "scale_2"


@dataclass(frozen=True, slots=True)
class SurfelCheckpoint:
    """The flat Gaussians of a 2DGS checkpoint."""

    run: TrainingRun
    cloud: Path  # the PLY
    splats: Splats  # their third scale is 0: its logarithm is −∞

    def describe(self) -> str:
        """Return a line with the Gaussian count and the SH degree of a 2DGS checkpoint."""
        splats = self.splats
        return f"{self.cloud}: {len(splats):,} flat Gaussians of SH degree {splats.degree}"


def read_surfels(path: Path, iteration: int | None = None) -> SurfelCheckpoint:
    """Read a 2DGS checkpoint: the folder of a training run, or a PLY file of any name."""
    run, cloud = open_cloud("2dgs", path, iteration, "the flat Gaussians")
    with format_faults(cloud):
        names = ply_properties(cloud)
        if _NORMAL_SCALE in names:
            message = "the PLY has three scales per Gaussian, expected the two of 2DGS"
            hint = f"Export it with `gsgen export static {cloud}`."
            raise CheckpointInvalid(message, where=str(cloud), hint=hint)
        groups = splat_groups(splat_degree([*names, _NORMAL_SCALE])) | {"log_scale": _SCALE_COLUMNS}
        tables = read_ply_columns(cloud, {name: list(group) for name, group in groups.items()})
    scale = tables["log_scale"]
    flat_log_scale = np.full((len(scale), 1), -np.inf, np.float32)
    splats = Splats(
        position=tables["position"],
        rotation=tables["rotation"],
        log_scale=np.concatenate([scale, flat_log_scale], axis=1),
        logit_opacity=tables["logit_opacity"][:, 0],
        sh=tables["sh"].reshape(len(scale), -1, 3),
    )
    return SurfelCheckpoint(run, cloud, splats)
