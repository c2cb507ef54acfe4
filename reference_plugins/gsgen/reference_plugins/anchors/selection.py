"""Culls anchors out of view, and limits the number that a frame decodes."""

__all__ = ["CULL_MODES", "Frustum", "Selection", "culling"]

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCloud
from gsgen.reference_plugins.anchors.prefilter import Prefilter
from gsgen.sdk import inputs
from gsgen.sdk.math import frustum_mask

Cull = Literal["none", "frustum", "published"]
CULL_MODES: tuple[Cull, ...] = ("none", "frustum", "published")

# Visible radius of a Gaussian in standard deviations.
_EXTENT_DEVIATIONS = 3.0


@dataclass(frozen=True, slots=True)
class Selection:
    """Options that select which anchors a frame decodes."""

    # ``none`` keeps anchors out of view; ``frustum`` hides those whose Gaussians cannot reach into
    # the image; ``published`` those that the published renderer skips
    cull: Cull = "none"
    # largest number of visible anchors to decode, in order; all if absent
    anchors: int | None = None


class Frustum(nn.Module):
    """Keeps every anchor whose Gaussians may reach into the image."""

    takes = ("projection",)

    anchor: Tensor
    reach: Tensor

    def __init__(self, cloud: AnchorCloud) -> None:
        super().__init__()
        offset = cloud.offset * torch.exp(cloud.log_scale[:, None, :3])
        # The networks shrink the anchor's scale and never stretch it.
        size = torch.exp(cloud.log_scale[:, 3:]).amax(dim=1)
        self.register_buffer("anchor", cloud.position)
        self.register_buffer("reach", offset.norm(dim=2).amax(dim=1) + _EXTENT_DEVIATIONS * size)

    def forward(
        self, camera: Float[Tensor, "4 4"], proj: Float[Tensor, "4 4"]
    ) -> Float[Tensor, "n 1"]:
        """Return 1 for anchors whose Gaussians may be in the image, and 0 for others."""
        return frustum_mask(self.anchor, camera, proj, self.reach).reshape(-1, 1)


def culling(cloud: AnchorCloud, cull: Cull) -> tuple[Frustum | Prefilter | None, tuple[Input, ...]]:
    """Return the module that culls anchors, and its model inputs besides the view matrix."""
    if cull == "frustum":
        return Frustum(cloud), (inputs.projection(),)
    if cull == "published":
        return Prefilter(cloud), (inputs.projection(), inputs.viewport())
    return None, ()
