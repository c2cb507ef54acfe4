"""Which anchors a camera needs, and how many of them a frame may decode."""

__all__ = ["CULLS", "Frustum", "Selection", "culling"]

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
CULLS: tuple[Cull, ...] = ("none", "frustum", "published")

# How far a Gaussian is seen, in standard deviations.
_EXTENT = 3.0


@dataclass(frozen=True, slots=True)
class Selection:
    """What is decoded.

    Attributes:
        cull: ``none`` hides no anchor for being out of view; ``frustum`` hides those of which no
            Gaussian can reach into the image; ``published`` those that the published renderer
            leaves out.
        anchors: Decode at most this many, those to be seen in their order; all where absent.
    """

    cull: Cull = "none"
    anchors: int | None = None


class Frustum(nn.Module):
    """Keeps every anchor of which a Gaussian may reach into the image."""

    takes = ("projection",)

    anchor: Tensor
    reach: Tensor

    def __init__(self, cloud: AnchorCloud) -> None:
        super().__init__()
        offset = cloud.offset * torch.exp(cloud.log_scale[:, None, :3])
        # The networks shrink the anchor's scale and never stretch it.
        size = torch.exp(cloud.log_scale[:, 3:]).amax(dim=1)
        self.register_buffer("anchor", cloud.position)
        self.register_buffer("reach", offset.norm(dim=2).amax(dim=1) + _EXTENT * size)

    def forward(
        self, camera: Float[Tensor, "4 4"], proj: Float[Tensor, "4 4"]
    ) -> Float[Tensor, "n 1"]:
        """Return 1 for anchors that may be seen and 0 for others."""
        return frustum_mask(self.anchor, camera, proj, self.reach).reshape(-1, 1)


def culling(
    cloud: AnchorCloud, cull: Cull
) -> tuple[Frustum | Prefilter | None, tuple[Input, ...]]:
    """Return the test of a culling, and the inputs that it takes besides the view."""
    if cull == "frustum":
        return Frustum(cloud), (inputs.projection(),)
    if cull == "published":
        return Prefilter(cloud), (inputs.projection(), inputs.viewport())
    return None, ()
