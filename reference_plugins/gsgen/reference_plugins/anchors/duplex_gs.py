"""Duplex-GS: networks decode ellipsoidal cells to Gaussians that stay within them.

Liu et al. 2025, "Duplex-GS: Proxy-Guided Weighted Blending for Real-Time Order-Independent
Gaussian Splatting". Levels and networks are those of Octree-GS. A Gaussian's scale is at most
(2 − ‖o‖) / 3 of its cell's, where o is its offset in units of the cell, as in the published code
(``gaussian_renderer/__init__.py``); the paper's equation 13 has 1 − ‖o‖.

The method's renderer blends by a weighted sum, cell after cell: ``blend="wsr"`` exports the cells
and their weights. Otherwise the model is for renderers that sort Gaussians.
"""

__all__ = ["BLEND_MODES", "OPACITIES", "DuplexGS"]

from typing import Literal, final

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.manifest import WeightedSum
from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCloud
from gsgen.reference_plugins.anchors.anchor_generator import AnchorGenerator, DecodedFrame
from gsgen.reference_plugins.anchors.cell_checkpoint import CellCheckpoint
from gsgen.reference_plugins.anchors.octree_gs import LevelGate, Levels
from gsgen.reference_plugins.anchors.selection import Selection
from gsgen.reference_plugins.tensors.harmonics import harmonic_sum
from gsgen.reference_plugins.tensors.layers import proportion
from gsgen.reference_plugins.tensors.planes import covariance_planes, stack_planes
from gsgen.sdk import Cells

# Lower limit of a quaternion's squared norm, so that zeros do not divide by zero.
_MIN_SQUARED_NORM = 1e-24

Opacity = Literal["decoded", "weighted"]
OPACITIES: tuple[Opacity, ...] = ("decoded", "weighted")
Blend = Literal["alpha", "wsr"]
BLEND_MODES: tuple[Blend, ...] = ("alpha", "wsr")


class _BoundedOpacity(nn.Module):
    """Computes Gaussian centres inside ellipsoidal cells, and each Gaussian's largest scale."""

    offset: Tensor

    def __init__(self, cloud: AnchorCloud) -> None:
        super().__init__()
        self.per_anchor = cloud.per_anchor
        self.register_buffer("offset", cloud.offset.flatten(1))

    def forward(
        self, cell: Float[Tensor, "n 3"], size: Float[Tensor, "n 3"]
    ) -> tuple[Float[Tensor, "n k3"], Float[Tensor, "n k"]]:
        offset = self.offset.reshape(-1, self.per_anchor, 3)
        squared_distance = (offset * offset).sum(dim=2)
        position = (cell[:, None] + offset * size[:, None]).flatten(1)
        return position, (2 - torch.sqrt(squared_distance)) / 3


@final
class DuplexGS(AnchorGenerator):
    """Duplex-GS as a model of N cells with K Gaussians each; row a K + k is Gaussian k of cell a.

    The opacity is that of the network or, if ``weighted``, that of the method's renderer: times
    the cell's visibility from the camera, and times 1 − depth / σ.
    """

    visibility: Tensor

    def __init__(
        self,
        checkpoint: CellCheckpoint,
        levels: Levels,
        *,
        opacity: Opacity = "decoded",
        blend: Blend = "alpha",
        appearance: int | None = None,
        selection: Selection = Selection(),  # noqa: B008
    ) -> None:
        if blend == "wsr" and opacity == "weighted":
            message = "a renderer of weighted sums weights opacities itself"
            hint = "Leave out --opacity, or give --blend alpha."
            raise GsgenError(message, where="--opacity weighted", hint=hint)
        cloud, nets = checkpoint.anchors.cloud, checkpoint.anchors.nets
        super().__init__(cloud, nets, appearance=appearance, selection=selection)
        self.level_gate = LevelGate(cloud, levels, half_cell=False)
        self.weighted = opacity == "weighted"
        weighting = checkpoint.weighting
        self.sigma = weighting.sigma if weighting.depth else None
        if blend == "wsr":
            self.weighted_sum = WeightedSum(
                weighting.background, self.sigma, weighting.opacity_divisor
            )
        if self.weighted or self.weighted_sum is not None:
            self.register_buffer("visibility", checkpoint.visibility)

    def placement_module(self, cloud: AnchorCloud) -> nn.Module:
        """Return the module that computes the centres and largest scales of Gaussians."""
        return _BoundedOpacity(cloud)

    @property
    def can_hide_anchors(self) -> bool:
        """Whether fine cells (groups of Gaussians) are hidden from distant cameras: always True."""
        return True

    def visible_share(self, centre: Float[Tensor, "1 3"]) -> Float[Tensor, "n 1"]:
        """Hide cells that are too fine for their distance; the last level of detail fades in."""
        visible: Tensor = self.level_gate(centre)
        return visible

    def scale_factors(
        self, factors: tuple[Tensor, ...], rows: Int[Tensor, " n"] | None
    ) -> list[Float[Tensor, "n k"]]:
        """Return the Gaussians' scale factors, limited so that Gaussians stay in the cell's ellipsoid."""
        limit = self.placements()[1]
        limit = limit if rows is None else torch.index_select(limit, 0, rows)
        return [torch.minimum(proportion(factor), limit) for factor in factors]

    def renderer_opacity(
        self, opacity: Float[Tensor, "n k"], frame: DecodedFrame
    ) -> Float[Tensor, "n k"]:
        """In weighted blending, multiply opacities by depth falloff and ellipsoid visibility."""
        if not self.weighted:
            return opacity
        opacity = opacity * self._visibility(frame)
        if self.sigma is None:
            return opacity
        cells = frame.position.reshape(-1, self.per_anchor, 3)
        depth = (cells * frame.camera[:3, 2]).sum(dim=2) + frame.camera[3, 2]
        return opacity * (1 - depth / self.sigma).clamp(0.0, 1.0)

    def cells(self, frame: DecodedFrame) -> Cells | None:
        """Return an ellipsoid per group of Gaussians, with the mean rotation of these Gaussians."""
        if self.weighted_sum is None:
            return None
        visibility = self._visibility(frame)
        if frame.visible is not None:
            visibility = visibility * (frame.visible > 0).to(visibility.dtype)
        size = frame.of(self.scale)
        planes = covariance_planes([size[:, i : i + 1] for i in range(3)], _cell_rotation(frame))
        return Cells(frame.anchor, visibility, covariance=stack_planes(planes))

    def _visibility(self, frame: DecodedFrame) -> Float[Tensor, "n 1"]:
        sh = frame.of(self.visibility)
        columns = [sh[:, index : index + 1] for index in range(sh.shape[1])]
        return torch.sigmoid(harmonic_sum(columns, frame.views.direction))


def _cell_rotation(frame: DecodedFrame) -> list[Float[Tensor, "n 1"]]:
    """Return the mean quaternion of each cell's Gaussians, weighted by their opacity.

    The published code also multiplies by the visibility, which is constant within a cell.
    """
    weight = torch.relu(frame.decoded.opacity)
    squared_distance = torch.stack([part * part for part in frame.decoded.rotation]).sum(dim=0)
    weight = weight / torch.sqrt(squared_distance.clamp(min=_MIN_SQUARED_NORM))
    return [(part * weight).sum(dim=1, keepdim=True) for part in frame.decoded.rotation]
