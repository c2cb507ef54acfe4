"""4DGaussians: a hexplane and a small network deform canonical Gaussians over time.

Wu et al. 2024, "4D Gaussian Splatting for Real-Time Dynamic Scene Rendering": the
features are those of its spatial-temporal structure encoder, the heads those of its multi-head
Gaussian deformation decoder. The only input is the time.
"""

__all__ = ["HexPlane4DGS"]

from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.deformation.hexplane_checkpoint import DeformationFlags, HexPlaneNets
from gsgen.reference_plugins.deformation.hexplane_field import HexPlaneField
from gsgen.reference_plugins.loading.canonical import Canonical
from gsgen.reference_plugins.loading.states import Layer
from gsgen.reference_plugins.tensors.baked_constants import Bake
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.reference_plugins.tensors.planes import covariance_planes, planes_of, stack_planes
from gsgen.sdk import GaussianGenerator, Gaussians, inputs


class _DeformationHead(nn.Module):
    """Two dense layers with ReLU between them, for features that already passed a ReLU."""

    def __init__(self, layer_pair: tuple[Layer, Layer]) -> None:
        super().__init__()
        self.first, self.second = Dense(*layer_pair[0]), Dense(*layer_pair[1])

    def forward(self, hidden: Tensor) -> Tensor:
        result: Tensor = self.second(torch.relu(self.first(hidden)))
        return result


@final
class HexPlane4DGS(GaussianGenerator):
    """4DGaussians as a generator model, whose Gaussians a hexplane deforms over time."""

    family = "4d"

    static_share: Tensor | None
    position: Tensor
    log_scale: Tensor
    rotation: Tensor
    logit_opacity: Tensor
    sh: Tensor

    def __init__(
        self,
        canonical: Canonical,
        nets: HexPlaneNets,
        flags: DeformationFlags,
        time: Input | None = None,
        *,
        bake: Bake = "auto",
    ) -> None:
        super().__init__()
        self.rows = len(canonical)
        self.inputs = (time or inputs.time(),)
        self.apply_rotation = flags.apply_rotation
        self.field = HexPlaneField(nets, canonical.position, bake)
        self.feature = nn.ModuleList(Dense(*layer) for layer in nets.feature)
        self.heads = nn.ModuleDict(
            {name: _DeformationHead(layer_pair) for name, layer_pair in nets.heads.items()}
        )
        self.static = _DeformationHead(nets.static) if nets.static is not None else None
        static_share = _static_share(canonical, nets) if nets.voxels is not None else None
        self.register_buffer("static_share", static_share)
        self.register_buffer("position", canonical.position)
        self.register_buffer("log_scale", canonical.log_scale)
        self.register_buffer("rotation", canonical.rotation)
        self.register_buffer("logit_opacity", canonical.logit_opacity)
        self.register_buffer("sh", canonical.sh.flatten(1))

    def forward(self, time: Float[Tensor, "1"]) -> Gaussians:
        """Return the deformed Gaussians at a given time."""
        hidden = self.field(time, self.position)
        for index, layer in enumerate(self.feature):
            hidden = layer(torch.relu(hidden) if index else hidden)
        hidden = torch.relu(hidden)
        static_fraction = self.static(hidden) if self.static is not None else self.static_share
        scale = torch.exp(self._deform_field("scales", self.log_scale, hidden, static_fraction))
        return Gaussians(
            position=self._deform_field("pos", self.position, hidden, static_fraction),
            opacity=torch.sigmoid(
                self._deform_field("opacity", self.logit_opacity, hidden, static_fraction)
            ),
            covariance=stack_planes(covariance_planes(planes_of(scale), self._rotation(hidden))),
            sh=self._deform_field("shs", self.sh, hidden, static_fraction).reshape(
                self.rows, -1, 3
            ),
        )

    def _deform_field(
        self, head: str, canonical: Tensor, hidden: Tensor, static_fraction: Tensor | None
    ) -> Tensor:
        """Return canonical attributes times a voxel grid's factor, plus predicted changes."""
        if head not in self.heads:
            return canonical
        masked_field = canonical if static_fraction is None else canonical * static_fraction
        deformed_field: Tensor = masked_field + self.heads[head](hidden)
        return deformed_field

    def _rotation(self, hidden: Tensor) -> list[Tensor]:
        """Return the deformed quaternions, one tensor per component; no voxel grid scales them."""
        rotation = planes_of(self.rotation)
        if "rotations" not in self.heads:
            return rotation
        rotation_change = planes_of(self.heads["rotations"](hidden))
        if self.apply_rotation:
            return _quaternion_product(rotation, rotation_change)
        return [a + b for a, b in zip(rotation, rotation_change, strict=True)]


def _quaternion_product(a: Sequence[Tensor], b: Sequence[Tensor]) -> list[Tensor]:
    """Return the Hamilton product of quaternions given as w, x, y, z."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]


def _static_share(canonical: Canonical, nets: HexPlaneNets) -> Float[Tensor, "n 1"]:
    """Interpolate factors that scale each Gaussian's canonical attributes in a voxel grid."""
    assert nets.voxels is not None
    grid, low, high = nets.voxels
    position = (canonical.position - low) / (high - low) * 2 - 1
    samples = position.flip(-1)[None, :, None, None]
    sampled_mask = torch.nn.functional.grid_sample(
        grid[None, None], samples, mode="bilinear", padding_mode="zeros", align_corners=True
    )
    return sampled_mask.reshape(-1, 1)
