"""4DGaussians: canonical Gaussians that a hexplane and a small network move.

Wu et al. 2024, "4D Gaussian Splatting for Real-Time Dynamic Scene Rendering": the
features are those of its spatial-temporal structure encoder, the heads those of its multi-head
Gaussian deformation decoder. Only time is asked for.
"""

__all__ = ["HexPlane4DGS"]

from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.deformation.hexplane_checkpoint import (
    Flags,
    HexPlaneNets,
    Layer,
)
from gsgen.reference_plugins.deformation.hexplane_field import HexPlaneField
from gsgen.reference_plugins.loading.canonical import Canonical
from gsgen.reference_plugins.tensors.baked_constants import Bake
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.reference_plugins.tensors.planes import covariance_planes, planes_of, stacked
from gsgen.sdk import GaussianGenerator, Gaussians, inputs


class _Head(nn.Module):
    """Two layers, for features that went through ReLU already."""

    def __init__(self, pair: tuple[Layer, Layer]) -> None:
        super().__init__()
        self.first, self.second = Dense(*pair[0]), Dense(*pair[1])

    def forward(self, hidden: Tensor) -> Tensor:
        made: Tensor = self.second(torch.relu(self.first(hidden)))
        return made


@final
class HexPlane4DGS(GaussianGenerator):
    """Gaussians that move with time."""

    family = "4d"

    still: Tensor | None
    position: Tensor
    log_scale: Tensor
    rotation: Tensor
    logit_opacity: Tensor
    sh: Tensor

    def __init__(
        self,
        canonical: Canonical,
        nets: HexPlaneNets,
        flags: Flags,
        time: Input | None = None,
        *,
        bake: Bake = "auto",
    ) -> None:
        """Bake what time does not change.

        Args:
            canonical: The Gaussians at rest.
            nets: What moves them.
            flags: Which parts take effect.
            time: How the input is declared; from 0 to 1 where absent.
            bake: What of the planes of space is stored; see :class:`HexPlaneField`.
        """
        super().__init__()
        self.rows = len(canonical)
        self.inputs = (time or inputs.time(),)
        self.apply_rotation = flags.apply_rotation
        self.field = HexPlaneField(nets, canonical.position, bake)
        self.feature = nn.ModuleList(Dense(*layer) for layer in nets.feature)
        self.heads = nn.ModuleDict({name: _Head(pair) for name, pair in nets.heads.items()})
        self.static = _Head(nets.static) if nets.static is not None else None
        still = _still(canonical, nets) if nets.voxels is not None else None
        self.register_buffer("still", still)
        self.register_buffer("position", canonical.position)
        self.register_buffer("log_scale", canonical.log_scale)
        self.register_buffer("rotation", canonical.rotation)
        self.register_buffer("logit_opacity", canonical.logit_opacity)
        self.register_buffer("sh", canonical.sh.flatten(1))

    def forward(self, time: Float[Tensor, "1"]) -> Gaussians:
        """Return the Gaussians at ``time``."""
        hidden = self.field(time, self.position)
        for index, layer in enumerate(self.feature):
            hidden = layer(torch.relu(hidden) if index else hidden)
        hidden = torch.relu(hidden)
        share = self.static(hidden) if self.static is not None else self.still
        scale = torch.exp(self._moved("scales", self.log_scale, hidden, share))
        return Gaussians(
            position=self._moved("pos", self.position, hidden, share),
            opacity=torch.sigmoid(
                self._moved("opacity", self.logit_opacity, hidden, share)
            ),
            covariance=stacked(covariance_planes(planes_of(scale), self._turned(hidden))),
            sh=self._moved("shs", self.sh, hidden, share).reshape(self.rows, -1, 3),
        )

    def _moved(
        self, head: str, rest: Tensor, hidden: Tensor, share: Tensor | None
    ) -> Tensor:
        """Return ``rest``, the part of it that stays and what its head adds."""
        if head not in self.heads:
            return rest
        kept = rest if share is None else rest * share
        made: Tensor = kept + self.heads[head](hidden)
        return made

    def _turned(self, hidden: Tensor) -> list[Tensor]:
        """Return the rotations as planes; no mask applies to them."""
        rest = planes_of(self.rotation)
        if "rotations" not in self.heads:
            return rest
        change = planes_of(self.heads["rotations"](hidden))
        if self.apply_rotation:
            return _product(rest, change)
        return [a + b for a, b in zip(rest, change, strict=True)]


def _product(a: Sequence[Tensor], b: Sequence[Tensor]) -> list[Tensor]:
    """Return the Hamilton product of quaternions given as w, x, y, z."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]


def _still(canonical: Canonical, nets: HexPlaneNets) -> Float[Tensor, "n 1"]:
    """Look up, trilinearly, how much of each Gaussian stays; outside the voxels nothing does."""
    assert nets.voxels is not None
    grid, low, high = nets.voxels
    place = (canonical.position - low) / (high - low) * 2 - 1
    at = place.flip(-1)[None, :, None, None]
    sampled = torch.nn.functional.grid_sample(
        grid[None, None], at, mode="bilinear", padding_mode="zeros", align_corners=True
    )
    return sampled.reshape(-1, 1)
