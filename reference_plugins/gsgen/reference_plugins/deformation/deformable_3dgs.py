"""Deformable-3D-Gaussians: a network of eight layers deforms canonical Gaussians over time.

Yang et al. 2024, "Deformable 3D Gaussians for High-Fidelity Monocular Dynamic Scene
Reconstruction": (δx, δr, δs) = F(γ(x), γ(t)) with the positional encoding γ. The only
input is the time.
"""

__all__ = ["Deformable3DGS"]

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.deformation.deformation_checkpoint import Deformation
from gsgen.reference_plugins.deformation.deformation_network import DeformationNetwork
from gsgen.reference_plugins.loading.canonical import Canonical
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.reference_plugins.tensors.planes import covariance_planes, planes_of, stack_planes
from gsgen.reference_plugins.tensors.positional_encoding import POINT_OCTAVES, positional_encoding
from gsgen.sdk import GaussianGenerator, Gaussians, inputs

# Rows of 256 numbers that fit into one binding of WebGPU (128 MiB).
MAX_ROWS = 131_072
# The published code adds this after the division, so its axes are not exactly of unit length.
_AXIS_SHIFT = 1e-5
_MIN_SQUARED_ANGLE = 1e-24


@final
class Deformable3DGS(GaussianGenerator):
    """Deformable-3D-Gaussians as a generator model: a network deforms Gaussians over time."""

    family = "4d"

    position: Tensor
    scale: Tensor
    rotation: Tensor
    opacity: Tensor
    sh: Tensor

    def __init__(
        self,
        canonical: Canonical,
        net: Deformation,
        time: Input | None = None,
        *,
        rows: int = MAX_ROWS,
    ) -> None:
        super().__init__()
        self.inputs = (time or inputs.time(),)
        self.rows, self.network = rows, DeformationNetwork(net)
        self.warp = nn.ModuleList(Dense(*layer) for layer in net.warp)
        self.turn, self.stretch = Dense(*net.rotation), Dense(*net.scaling)
        self.register_buffer("position", canonical.position)
        self.register_buffer("scale", torch.exp(canonical.log_scale))
        unit = torch.nn.functional.normalize(canonical.rotation, dim=1, eps=1e-12)
        self.register_buffer("rotation", unit)
        self.register_buffer("opacity", torch.sigmoid(canonical.logit_opacity))
        self.register_buffer("sh", canonical.sh)

    def forward(self, time: Float[Tensor, "1"]) -> Gaussians:
        """Return the deformed Gaussians at a given time."""
        moment = self.network.moment(time)
        count = self.position.shape[0]
        parts = [
            self._deform_part(slice(start, start + self.rows), moment)
            for start in range(0, count, self.rows)
        ]
        position, covariance = (
            tensors[0] if len(tensors) == 1 else torch.cat(tensors)
            for tensors in zip(*parts, strict=True)
        )
        return Gaussians(position=position, opacity=self.opacity, covariance=covariance, sh=self.sh)

    def _deform_part(self, part: slice, moment: Tensor) -> tuple[Tensor, Tensor]:
        """Return centres and covariances of a range of Gaussians after the deformation."""
        position = self.position[part]
        hidden = self.network(positional_encoding(position, POINT_OCTAVES), moment)
        scale = self.scale[part] + self.stretch(hidden)
        # Not normalised, as in the published rasteriser.
        rotation = self.rotation[part] + self.turn(hidden)
        covariance = covariance_planes(planes_of(scale), planes_of(rotation), normalise=False)
        return self._deform_position(position, hidden), stack_planes(covariance)

    def _deform_position(self, position: Tensor, hidden: Tensor) -> Tensor:
        if len(self.warp) == 1:
            shifted_position: Tensor = position + self.warp[0](hidden)
            return shifted_position
        axis, moment = self.warp
        return _screw_motion(position, axis(hidden), moment(hidden))


def _screw_motion(
    point: Float[Tensor, "n 3"], axis: Float[Tensor, "n 3"], moment: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3"]:
    """Move points by screw motions, as Deformable-3D-Gaussians does (``utils/rigid_utils.py``).

    With θ = ‖axis‖ the unit screw is w = axis/θ + 1e-5 and v = moment/θ + 1e-5, W its cross
    product, and a point goes to (I + sin θ W + (1 − cos θ) W²) x + (θ I + (1 − cos θ) W +
    (θ − sin θ) W²) v.
    """
    theta = torch.sqrt((axis * axis).sum(dim=1, keepdim=True).clamp(min=_MIN_SQUARED_ANGLE))
    w = axis / theta + _AXIS_SHIFT
    v = moment / theta + _AXIS_SHIFT
    sine, one_minus_cosine = torch.sin(theta), 1 - torch.cos(theta)
    axis_cross_point, axis_cross_velocity = _cross_product(w, point), _cross_product(w, v)
    rotated_point = (
        point + sine * axis_cross_point + one_minus_cosine * _cross_product(w, axis_cross_point)
    )
    return (
        rotated_point
        + theta * v
        + one_minus_cosine * axis_cross_velocity
        + (theta - sine) * _cross_product(w, axis_cross_velocity)
    )


def _cross_product(a: Float[Tensor, "n 3"], b: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    ax, ay, az = a[:, 0:1], a[:, 1:2], a[:, 2:3]
    bx, by, bz = b[:, 0:1], b[:, 1:2], b[:, 2:3]
    return torch.cat([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], dim=1)
