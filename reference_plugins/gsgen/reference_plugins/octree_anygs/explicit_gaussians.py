"""Explicit Gaussians of Octree-AnyGS: splats with SH colours, which belong to levels of detail.

An anchor has one Gaussian, x + O · l, with its own rotation, scale, opacity and colour. Nothing but
the opacity depends on the camera: it is 0 where the level is too fine for the distance.
"""

__all__ = ["LeveledGaussians", "explicit_splats"]

from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.formats import Splats
from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCloud
from gsgen.reference_plugins.anchors.octree_gs import LevelGate, Levels
from gsgen.reference_plugins.octree_anygs.anygs_checkpoint import ExplicitColors
from gsgen.sdk import GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import camera_centre


def explicit_splats(cloud: AnchorCloud, colors: ExplicitColors, *, flat: bool) -> Splats:
    """Return the Gaussians of all levels of detail as splats; ``flat`` ones lack thickness."""
    scale = cloud.log_scale.double()
    position = cloud.position.double() + cloud.offset.double()[:, 0] * torch.exp(scale[:, :3])
    log_scale = cloud.log_scale[:, 3:].clone()
    if flat:
        log_scale[:, 2] = -torch.inf
    return Splats(
        position=position.float().numpy(),
        rotation=cloud.rotation.numpy(),
        log_scale=log_scale.numpy(),
        logit_opacity=colors.logit_opacity[:, 0].numpy(),
        sh=colors.sh.numpy(),
    )


@final
class LeveledGaussians(GaussianGenerator):
    """A model of Gaussians that are hidden if their level of detail is too fine for a distance."""

    family = "static"
    count_semantics = "upper-bound"

    position: Tensor
    opacity: Tensor
    covariance: Tensor
    sh: Tensor

    def __init__(
        self, cloud: AnchorCloud, colors: ExplicitColors, levels: Levels, *, flat: bool
    ) -> None:
        super().__init__()
        splats = explicit_splats(cloud, colors, flat=flat)
        scale = np.exp(splats.log_scale.astype(np.float64))
        covariance = covariance_upper(scale, splats.rotation).astype(np.float32)
        self.inputs = (inputs.view(),)
        self.level_gate = LevelGate(cloud, levels, half_cell=False)
        self.register_buffer("position", torch.from_numpy(splats.position))
        self.register_buffer("opacity", torch.sigmoid(colors.logit_opacity))
        self.register_buffer("covariance", torch.from_numpy(covariance))
        self.register_buffer("sh", colors.sh)

    def forward(self, camera: Float[Tensor, "4 4"]) -> Gaussians:
        """Return the Gaussians for a camera: a world→camera matrix in column order."""
        visible = self.level_gate(camera_centre(camera).reshape(1, 3))
        return Gaussians(
            position=self.position,
            opacity=(self.opacity * visible).reshape(-1),
            covariance=self.covariance,
            sh=self.sh,
        )
