"""What Scaffold-GS and its descendants share: anchors decoded for the camera at hand."""

__all__ = ["AnchorGenerator"]

from abc import abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.anchor_heads import AnchorHeads
from gsgen.reference_plugins.camera import camera_centre, directions
from gsgen.reference_plugins.checkpoints.anchors import AnchorCloud, AnchorNets
from gsgen.reference_plugins.planes import covariance_planes, stacked
from gsgen.reference_plugins.prefilter import Prefilter
from gsgen.sdk import GaussianGenerator, Gaussians, inputs


class AnchorGenerator(GaussianGenerator):
    """N anchors with K Gaussians each; row a K + k is Gaussian k of anchor a.

    Inputs are the view, projection and viewport if there is a prefilter, and the appearance if
    there is a choice, in this order.
    """

    family = "mlp"
    count_semantics = "upper-bound"

    anchor: Tensor
    scale: Tensor
    position: Tensor

    def __init__(
        self,
        cloud: AnchorCloud,
        nets: AnchorNets,
        *,
        appearance: int | None = None,
        prefilter: bool = False,
    ) -> None:
        """Fold what the camera does not change.

        Args:
            cloud: The anchors.
            nets: Their networks.
            appearance: Which appearance to keep; an input chooses where absent.
            prefilter: Hide anchors that are out of view, as the published renderer does.
        """
        super().__init__()
        self.heads = AnchorHeads(cloud, nets, appearance)
        self.prefilter = Prefilter(cloud) if prefilter else None
        declared = [inputs.view()]
        declared += [inputs.projection(), inputs.viewport()] if prefilter else []
        choices = self.heads.appearances
        declared += [inputs.appearance_id(choices)] if choices else []
        self.inputs = tuple(declared)
        self.register_buffer("anchor", cloud.position)
        self.register_buffer("scale", torch.exp(cloud.log_scale[:, 3:]))
        reach = torch.exp(cloud.log_scale[:, None, :3])
        position = cloud.position[:, None] + cloud.offset * reach
        self.register_buffer("position", position.reshape(-1, 3))

    def forward(self, camera: Float[Tensor, "4 4"], *others: Tensor) -> Gaussians:
        """Decode all anchors for ``camera``, the world→camera matrix in column order."""
        centre = camera_centre(camera)
        direction, distance = directions(self.anchor, centre)
        made = self.heads(
            direction, distance, others[-1] if self.heads.appearances else None
        )
        opacity = self.shown(torch.relu(made.opacity), centre)
        if self.prefilter is not None:
            opacity = opacity * self.prefilter(camera, others[0], others[1])
        scale = [
            torch.sigmoid(factor) * self.scale[:, axis : axis + 1]
            for axis, factor in enumerate(made.scale)
        ]
        return Gaussians(
            position=self.position,
            opacity=opacity.reshape(-1),
            covariance=stacked(covariance_planes(scale, made.rotation)),
            rgb=torch.sigmoid(made.color),
        )

    @abstractmethod
    def shown(
        self, opacity: Float[Tensor, "n k"], centre: Float[Tensor, "1 3"]
    ) -> Float[Tensor, "n k"]:
        """Return the opacity that anchors have from ``centre``: zero where not to be seen."""
