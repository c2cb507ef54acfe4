"""The base class of Scaffold-GS, Octree-GS and Duplex-GS: decodes anchors for a camera."""

__all__ = ["MIN_SQUARED_DISTANCE", "AnchorGenerator", "DecodedFrame"]

from abc import abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.contract.errors import GsgenError
from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCloud, AnchorNets
from gsgen.reference_plugins.anchors.anchor_heads import AnchorHeads, AnchorViews, DecodedAnchors
from gsgen.reference_plugins.anchors.selection import Selection, culling
from gsgen.reference_plugins.tensors.baked_constants import Constants
from gsgen.reference_plugins.tensors.layers import proportion
from gsgen.reference_plugins.tensors.planes import covariance_planes, stack_planes
from gsgen.sdk import Cells, GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import camera_centre, keep_rows

MIN_SQUARED_DISTANCE = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodedFrame:
    """The anchors that are decoded for a frame, with their decoded values."""

    camera: Float[Tensor, "4 4"]  # World→camera matrix in column order
    views: AnchorViews  # direction and distance of each anchor
    anchor: Float[Tensor, "n 3"]  # centres of the anchors
    position: Float[Tensor, "n k3"]  # centres of the Gaussians, as x y z triples side by side
    decoded: DecodedAnchors  # outputs of the networks
    # visible share of each anchor, 0 to 1; 1 for all if absent
    visible: Float[Tensor, "n 1"] | None = None
    rows: Int[Tensor, " n"] | None = None  # row numbers of the anchors; all in order if absent

    def of(self, table: Tensor) -> Tensor:
        """Return the rows of a per-anchor tensor that belong to the decoded anchors."""
        if self.rows is None:
            return table
        return torch.index_select(table, 0, self.rows)


class _AnchorOffsets(nn.Module):
    """Computes the centres of Gaussians from offsets in units of their anchor's scale."""

    offset: Tensor
    reach: Tensor

    def __init__(self, cloud: AnchorCloud) -> None:
        super().__init__()
        self.per_anchor = cloud.per_anchor
        self.register_buffer("offset", cloud.offset.flatten(1))
        self.register_buffer("reach", torch.exp(cloud.log_scale[:, :3]))

    def forward(
        self, anchor: Float[Tensor, "n 3"], scale: Float[Tensor, "n 3"]
    ) -> tuple[Float[Tensor, "n k3"]]:
        offset = self.offset.reshape(-1, self.per_anchor, 3)
        return ((anchor[:, None] + offset * self.reach[:, None]).flatten(1),)


class AnchorGenerator(GaussianGenerator):
    """A generator model of N anchors with K Gaussians each; row a K + k is Gaussian k of anchor a.

    Inputs are the view, those of the culling, and the appearance if there are several. If a frame
    decodes at most a given number of anchors, the rows are those of the visible anchors in order,
    and the count is their number.
    """

    family = "mlp"
    count_semantics = "upper-bound"

    anchor: Tensor
    scale: Tensor

    def __init__(
        self,
        cloud: AnchorCloud,
        nets: AnchorNets,
        *,
        appearance: int | None = None,
        selection: Selection = Selection(),  # noqa: B008
    ) -> None:
        super().__init__()
        self.per_anchor = cloud.per_anchor
        self.heads = AnchorHeads(cloud, nets, appearance)
        self.cull, declared = culling(cloud, selection.cull)
        choices = self.heads.appearances
        declared += (inputs.appearance_id(choices),) if choices else ()
        self.inputs = (inputs.view(), *declared)
        self.smaller = ("--cull frustum --max-anchors N",)
        self.max_anchors = selection.anchors
        if self.max_anchors is not None and self.cull is None and not self.can_hide_anchors:
            message = f"max_anchors is {self.max_anchors}, but no culling selects the anchors"
            hint = "Add --cull frustum."
            raise GsgenError(message, where="--max-anchors", hint=hint)
        if self.max_anchors is not None and self.max_anchors >= len(cloud):
            self.max_anchors = None
        self.register_buffer("anchor", cloud.position)
        self.register_buffer("scale", torch.exp(cloud.log_scale[:, 3:]))
        self.placement = Constants(self.placement_module(cloud), (self.anchor, self.scale))

    def placement_module(self, cloud: AnchorCloud) -> nn.Module:
        """Return the module that computes the centres of Gaussians from anchors and scales."""
        return _AnchorOffsets(cloud)

    @property
    def can_hide_anchors(self) -> bool:
        """Whether the published method hides anchors from some cameras, as levels of detail do."""
        return False

    def forward(self, camera: Float[Tensor, "4 4"], *extra_inputs: Tensor) -> Gaussians:
        """Decode the anchors to Gaussians for a camera: a world→camera matrix in column order."""
        centre = camera_centre(camera).reshape(1, 3)
        visible = self._combined_share(camera, centre, extra_inputs)
        rows = count = None
        if self.max_anchors is not None and visible is not None:
            rows, count = keep_rows(visible.reshape(-1), self.max_anchors)
            visible = torch.index_select(visible, 0, rows)
        anchor, base, position = (
            table if rows is None else torch.index_select(table, 0, rows)
            for table in (self.anchor, self.scale, self.placements()[0])
        )
        views = _anchor_views(anchor, centre, extra_inputs, self.heads.appearances)
        decoded = self.heads(views, rows)
        frame = DecodedFrame(
            camera=camera,
            views=views,
            anchor=anchor,
            position=position,
            decoded=decoded,
            visible=visible,
            rows=rows,
        )
        opacity = self.renderer_opacity(torch.relu(decoded.opacity), frame)
        scale = [
            factor * base[:, axis : axis + 1]
            for axis, factor in enumerate(self.scale_factors(decoded.scale, rows))
        ]
        return Gaussians(
            position=position.reshape(-1, 3),
            opacity=(opacity if visible is None else opacity * visible).reshape(-1),
            covariance=stack_planes(covariance_planes(scale, decoded.rotation)),
            rgb=torch.sigmoid(decoded.color),
            count=None if count is None else count * self.per_anchor,
            cells=self.cells(frame),
        )

    def placements(self) -> tuple[Tensor, ...]:
        """Return the Gaussians' centres, and in subclasses more tensors, such as scale limits."""
        tensors: tuple[Tensor, ...] = self.placement(self.anchor, self.scale)
        return tensors

    def scale_factors(
        self, factors: tuple[Tensor, ...], rows: Int[Tensor, " n"] | None
    ) -> list[Float[Tensor, "n k"]]:
        """Return the Gaussians' scale along each axis as a share of their anchor's scale."""
        return [proportion(factor) for factor in factors]

    def renderer_opacity(
        self, opacity: Float[Tensor, "n k"], frame: DecodedFrame
    ) -> Float[Tensor, "n k"]:
        """Convert the opacity that a network predicts to the opacity that the renderer expects."""
        return opacity

    def cells(self, frame: DecodedFrame) -> Cells | None:
        """Return the groups of Gaussians for blending by weighted sums; None for depth sorting."""
        return None

    def _combined_share(
        self, camera: Tensor, centre: Tensor, extra_inputs: tuple[Tensor, ...]
    ) -> Float[Tensor, "n 1"] | None:
        visible = self.visible_share(centre)
        if self.cull is None:
            return visible
        visible_mask: Tensor = self.cull(camera, *extra_inputs[: len(self.cull.takes)])
        return visible_mask if visible is None else visible * visible_mask

    @abstractmethod
    def visible_share(self, centre: Float[Tensor, "1 3"]) -> Float[Tensor, "n 1"] | None:
        """Return the visibility of each anchor from a camera centre, 0 to 1; None if all are 1."""


def _anchor_views(
    anchor: Float[Tensor, "n 3"],
    centre: Float[Tensor, "1 3"],
    extra_inputs: tuple[Tensor, ...],
    appearances: int,
) -> AnchorViews:
    """Return directions and distances of the anchors, finite even for a camera on an anchor."""
    offset = anchor - centre
    squared_distance = (offset * offset).sum(dim=1, keepdim=True)
    distance = torch.sqrt(squared_distance.clamp(min=MIN_SQUARED_DISTANCE))
    return AnchorViews(offset / distance, distance, extra_inputs[-1] if appearances else None)
