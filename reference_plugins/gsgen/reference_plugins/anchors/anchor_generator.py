"""What Scaffold-GS and its descendants share: anchors decoded for the camera at hand."""

__all__ = ["AnchorGenerator", "Decoding"]

from abc import abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.contract.errors import GsgenError
from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCloud, AnchorNets
from gsgen.reference_plugins.anchors.anchor_heads import AnchorHeads, Asked, Decoded
from gsgen.reference_plugins.anchors.selection import Selection, culling
from gsgen.reference_plugins.tensors.baked_constants import Constants
from gsgen.reference_plugins.tensors.layers import proportion
from gsgen.reference_plugins.tensors.planes import covariance_planes, stacked
from gsgen.sdk import Cells, GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import camera_centre, keep_rows

_SMALLEST_SQUARE = 1e-12


@dataclass(frozen=True, slots=True)
class Decoding:
    """The anchors of one frame, and from where they are seen.

    Attributes:
        camera: World→camera matrix in column order.
        asked: Direction and distance of each anchor.
        anchor: Their centres.
        position: Centres of their Gaussians, x y z after each other.
        made: What the networks say of them.
        shown: How much of each anchor is seen, 0 to 1; all where absent.
        rows: Which anchors they are; all, in order, where absent.
    """

    camera: Float[Tensor, "4 4"]
    asked: Asked
    anchor: Float[Tensor, "n 3"]
    position: Float[Tensor, "n k3"]
    made: Decoded
    shown: Float[Tensor, "n 1"] | None = None
    rows: Int[Tensor, " n"] | None = None

    def of(self, table: Tensor) -> Tensor:
        """Return the rows of ``table`` that belong to these anchors."""
        if self.rows is None:
            return table
        return torch.index_select(table, 0, self.rows)


class _Places(nn.Module):
    """Centres of Gaussians: offsets in units of a scale of the anchor's own."""

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
    """N anchors with K Gaussians each; row a K + k is Gaussian k of anchor a.

    Inputs are the view, those of the culling, and the appearance if there is a choice. Where a
    frame may only decode so many anchors, rows are those of the anchors to be seen, in order, and
    the count says how many there are.
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
        """Fold what the camera does not change.

        Args:
            cloud: The anchors.
            nets: Their networks.
            appearance: Which appearance to keep; an input chooses where absent.
            selection: Which anchors are decoded.

        Raises:
            GsgenError: Only some anchors may be decoded, and nothing says which.
        """
        super().__init__()
        self.per_anchor = cloud.per_anchor
        self.heads = AnchorHeads(cloud, nets, appearance)
        self.cull, declared = culling(cloud, selection.cull)
        choices = self.heads.appearances
        declared += (inputs.appearance_id(choices),) if choices else ()
        self.inputs = (inputs.view(), *declared)
        self.most = selection.anchors
        if self.most is not None and self.cull is None and not self.hides:
            what = f"{self.most} anchors at most, but nothing says which are not needed"
            hint = "Give --cull frustum, too."
            raise GsgenError(what, where="--max-anchors", hint=hint)
        if self.most is not None and self.most >= len(cloud):
            self.most = None
        self.register_buffer("anchor", cloud.position)
        self.register_buffer("scale", torch.exp(cloud.log_scale[:, 3:]))
        self.places = Constants(self.placing(cloud), (self.anchor, self.scale))

    def placing(self, cloud: AnchorCloud) -> nn.Module:
        """Return what makes the centres of Gaussians, and what else follows from their offsets."""
        return _Places(cloud)

    @property
    def hides(self) -> bool:
        """Whether the method itself hides anchors from some cameras."""
        return False

    def forward(self, camera: Float[Tensor, "4 4"], *others: Tensor) -> Gaussians:
        """Decode anchors for ``camera``, the world→camera matrix in column order."""
        centre = camera_centre(camera).reshape(1, 3)
        shown = self._shown(camera, centre, others)
        rows = count = None
        if self.most is not None and shown is not None:
            rows, count = keep_rows(shown.reshape(-1), self.most)
            shown = torch.index_select(shown, 0, rows)
        anchor, base, position = (
            one if rows is None else torch.index_select(one, 0, rows)
            for one in (self.anchor, self.scale, self.placed()[0])
        )
        asked = _asked(anchor, centre, others, self.heads.appearances)
        made = self.heads(asked, rows)
        now = Decoding(camera, asked, anchor, position, made, shown, rows)
        opacity = self.weighed(torch.relu(made.opacity), now)
        scale = [
            factor * base[:, axis : axis + 1]
            for axis, factor in enumerate(self.shares(made.scale, rows))
        ]
        return Gaussians(
            position=position.reshape(-1, 3),
            opacity=(opacity if shown is None else opacity * shown).reshape(-1),
            covariance=stacked(covariance_planes(scale, made.rotation)),
            rgb=torch.sigmoid(made.color),
            count=None if count is None else count * self.per_anchor,
            cells=self.cells(now),
        )

    def placed(self) -> tuple[Tensor, ...]:
        """Return what :meth:`placing` makes, of all anchors."""
        made: tuple[Tensor, ...] = self.places(self.anchor, self.scale)
        return made

    def shares(
        self, factors: tuple[Tensor, ...], rows: Int[Tensor, " n"] | None
    ) -> list[Float[Tensor, "n k"]]:
        """Return how large Gaussians are along each axis, as a share of their anchor's scale."""
        return [proportion(factor) for factor in factors]

    def weighed(self, opacity: Float[Tensor, "n k"], now: Decoding) -> Float[Tensor, "n k"]:
        """Return what a renderer takes as opacity, of what the network says."""
        return opacity

    def cells(self, now: Decoding) -> Cells | None:
        """Return the anchors as cells of a weighted sum, where the method blends by one."""
        return None

    def _shown(
        self, camera: Tensor, centre: Tensor, others: tuple[Tensor, ...]
    ) -> Float[Tensor, "n 1"] | None:
        shown = self.shown(centre)
        if self.cull is None:
            return shown
        seen: Tensor = self.cull(camera, *others[: len(self.cull.takes)])
        return seen if shown is None else shown * seen

    @abstractmethod
    def shown(self, centre: Float[Tensor, "1 3"]) -> Float[Tensor, "n 1"] | None:
        """Return how much of each anchor is seen from ``centre``, 0 to 1; all where None."""


def _asked(
    anchor: Float[Tensor, "n 3"],
    centre: Float[Tensor, "1 3"],
    others: tuple[Tensor, ...],
    appearances: int,
) -> Asked:
    """Return from where anchors are seen; a camera on an anchor gives numbers, too."""
    offset = anchor - centre
    square = (offset * offset).sum(dim=1, keepdim=True)
    distance = torch.sqrt(square.clamp(min=_SMALLEST_SQUARE))
    return Asked(offset / distance, distance, others[-1] if appearances else None)
