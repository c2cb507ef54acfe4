"""Duplex-GS: ellipsoidal cells whose networks make Gaussians that stay within them.

Liu et al. 2025, "Duplex-GS: Proxy-Guided Weighted Blending for Real-Time Order-Independent
Gaussian Splatting". Levels and networks are those of Octree-GS. A Gaussian's scale is bounded by
(2 − ‖o‖) / 3 of its cell's, o being its offset in units of the cell; the paper's equation 13 says
1 − ‖o‖, the published code (``gaussian_renderer/__init__.py``) what stands here.

The method's renderer sums Gaussians by weights, cell after cell: ``blend="wsr"`` gives it the cells
and their weights. Without, the model is one for renderers that sort Gaussians.
"""

__all__ = ["BLENDS", "OPACITIES", "DuplexGS"]

from collections.abc import Iterator
from typing import Literal, final

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.manifest import WeightedSum
from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCloud
from gsgen.reference_plugins.anchors.anchor_generator import AnchorGenerator, Decoding
from gsgen.reference_plugins.anchors.cell_checkpoint import CellCheckpoint
from gsgen.reference_plugins.anchors.octree_gs import LevelGate, Levels
from gsgen.reference_plugins.anchors.selection import Selection
from gsgen.reference_plugins.tensors.layers import proportion
from gsgen.reference_plugins.tensors.planes import covariance_planes, stacked
from gsgen.sdk import Cells

# Of a quaternion, so that one of zeros does not divide by zero.
_SMALLEST_SQUARE = 1e-24

Opacity = Literal["decoded", "weighted"]
OPACITIES: tuple[Opacity, ...] = ("decoded", "weighted")
Blend = Literal["alpha", "wsr"]
BLENDS: tuple[Blend, ...] = ("alpha", "wsr")


class _Bounded(nn.Module):
    """Centres of Gaussians, offset in units of their cell, and how large they may be."""

    offset: Tensor

    def __init__(self, cloud: AnchorCloud) -> None:
        super().__init__()
        self.per_anchor = cloud.per_anchor
        self.register_buffer("offset", cloud.offset.flatten(1))

    def forward(
        self, cell: Float[Tensor, "n 3"], size: Float[Tensor, "n 3"]
    ) -> tuple[Float[Tensor, "n k3"], Float[Tensor, "n k"]]:
        offset = self.offset.reshape(-1, self.per_anchor, 3)
        square = (offset * offset).sum(dim=2)
        position = (cell[:, None] + offset * size[:, None]).flatten(1)
        return position, (2 - torch.sqrt(square)) / 3


@final
class DuplexGS(AnchorGenerator):
    """N cells with K Gaussians each; row a K + k is Gaussian k of cell a.

    Opacity is what the network says, or, ``weighted``, what the method's renderer makes of it:
    multiplied by the cell's visibility from the camera, and by 1 − depth / σ.
    """

    visibility: Tensor

    def __init__(
        self,
        read: CellCheckpoint,
        levels: Levels,
        *,
        opacity: Opacity = "decoded",
        blend: Blend = "alpha",
        appearance: int | None = None,
        selection: Selection = Selection(),  # noqa: B008
    ) -> None:
        """Fold what the camera does not change.

        Args:
            read: Cells and networks.
            levels: How levels follow from distances.
            opacity: As the network says, or weighted as the method's renderer does.
            blend: For renderers that sort Gaussians, or for those that sum them cell by cell.
            appearance: Which appearance to keep; an input chooses where absent.
            selection: Which cells are decoded.

        Raises:
            GsgenError: Opacities are weighted, and a renderer would weigh them again.
        """
        if blend == "wsr" and opacity == "weighted":
            what = "a renderer that sums by weights weighs opacities itself"
            hint = "Leave --opacity out, or blend by alpha."
            raise GsgenError(what, where="--opacity weighted", hint=hint)
        cloud, nets = read.anchors.cloud, read.anchors.nets
        super().__init__(cloud, nets, appearance=appearance, selection=selection)
        self.gate = LevelGate(cloud, levels, half_cell=False)
        self.weighted = opacity == "weighted"
        how = read.weighting
        self.sigma = how.sigma if how.depth else None
        if blend == "wsr":
            self.weighted_sum = WeightedSum(how.background, self.sigma, how.grade)
        if self.weighted or self.weighted_sum is not None:
            self.register_buffer("visibility", read.visibility)

    def placing(self, cloud: AnchorCloud) -> nn.Module:
        """Return what makes the centres of Gaussians and their bounds; a cell has one size."""
        return _Bounded(cloud)

    @property
    def hides(self) -> bool:
        """Whether the method itself hides cells from some cameras: it does."""
        return True

    def shown(self, centre: Float[Tensor, "1 3"]) -> Float[Tensor, "n 1"]:
        """Hide cells finer than their distance asks for; the last level fades in."""
        seen: Tensor = self.gate(centre)
        return seen

    def shares(
        self, factors: tuple[Tensor, ...], rows: Int[Tensor, " n"] | None
    ) -> list[Float[Tensor, "n k"]]:
        """Keep Gaussians within their cell."""
        limit = self.placed()[1]
        limit = limit if rows is None else torch.index_select(limit, 0, rows)
        return [torch.minimum(proportion(factor), limit) for factor in factors]

    def weighed(self, opacity: Float[Tensor, "n k"], now: Decoding) -> Float[Tensor, "n k"]:
        """Weigh opacities, where that was asked for."""
        if not self.weighted:
            return opacity
        opacity = opacity * self._seen(now)
        if self.sigma is None:
            return opacity
        cells = now.position.reshape(-1, self.per_anchor, 3)
        depth = (cells * now.camera[:3, 2]).sum(dim=2) + now.camera[3, 2]
        return opacity * (1 - depth / self.sigma).clamp(0.0, 1.0)

    def cells(self, now: Decoding) -> Cells | None:
        """Return the cells: ellipsoids turned as their Gaussians are on average."""
        if self.weighted_sum is None:
            return None
        visibility = self._seen(now)
        if now.shown is not None:
            visibility = visibility * (now.shown > 0).to(visibility.dtype)
        size = now.of(self.scale)
        planes = covariance_planes([size[:, i : i + 1] for i in range(3)], _turned(now))
        return Cells(now.anchor, visibility, covariance=stacked(planes))

    def _seen(self, now: Decoding) -> Float[Tensor, "n 1"]:
        """Return how visible each cell is from where the camera is, 0 to 1."""
        return torch.sigmoid(_evaluated(now.of(self.visibility), now.asked.direction))


def _turned(now: Decoding) -> list[Float[Tensor, "n 1"]]:
    """Return the mean of the quaternions of each cell's Gaussians, weighted by their opacity.

    The published code weighs by opacity and visibility; the latter is one number a cell.
    """
    weight = torch.relu(now.made.opacity)
    square = torch.stack([part * part for part in now.made.rotation]).sum(dim=0)
    weight = weight / torch.sqrt(square.clamp(min=_SMALLEST_SQUARE))
    return [(part * weight).sum(dim=1, keepdim=True) for part in now.made.rotation]


def _evaluated(
    sh: Float[Tensor, "n k"], direction: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 1"]:
    """Sum one channel of spherical harmonics (degree 0 to 3, signs as in 3DGS)."""
    x, y, z = direction[:, 0:1], direction[:, 1:2], direction[:, 2:3]
    total: Tensor | float = 0.0
    for index, function in zip(range(sh.shape[1]), _basis(x, y, z), strict=False):
        total = total + sh[:, index : index + 1] * function
    assert isinstance(total, Tensor)
    return total


def _basis(x: Tensor, y: Tensor, z: Tensor) -> Iterator[Tensor | float]:
    """Yield the real functions in the order of 3DGS (Kerbl et al. 2023, constants of its code)."""
    xx, yy, zz = x * x, y * y, z * z
    yield 0.28209479177387814
    yield -0.4886025119029199 * y
    yield 0.4886025119029199 * z
    yield -0.4886025119029199 * x
    yield 1.0925484305920792 * (x * y)
    yield -1.0925484305920792 * (y * z)
    yield 0.31539156525252005 * (2 * zz - xx - yy)
    yield -1.0925484305920792 * (x * z)
    yield 0.5462742152960396 * (xx - yy)
    yield -0.5900435899266435 * (y * (3 * xx - yy))
    yield 2.890611442640554 * (x * y * z)
    yield -0.4570457994644658 * (y * (4 * zz - xx - yy))
    yield 0.3731763325901154 * (z * (2 * zz - 3 * xx - 3 * yy))
    yield -0.4570457994644658 * (x * (4 * zz - xx - yy))
    yield 1.445305721320277 * (z * (xx - yy))
    yield -0.5900435899266435 * (x * (xx - 3 * yy))
