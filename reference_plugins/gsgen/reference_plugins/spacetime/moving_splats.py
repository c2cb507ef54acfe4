"""The motion of SpacetimeGaussians: polynomials, and opacity that rises and falls once.

Li et al. 2024, "Spacetime Gaussian Feature Splatting for Real-Time Dynamic View Synthesis",
equations 5 to 8: with dt = t − μ the centre is x + Σ bₖ dtᵏ, the rotation q + dt ω, and the
opacity σ(o) exp(−(dt/s)²).
"""

__all__ = ["MovingSplats"]

from abc import ABC

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.spacetime.spacetime_checkpoint import SpacetimeSplats
from gsgen.reference_plugins.tensors.planes import covariance_planes, planes_of, stack_planes
from gsgen.sdk import GaussianGenerator

# 1 / duration is at most this, so that its square, times a squared time, is finite in float32.
_MAX_RATE = 1e15


class MovingSplats(GaussianGenerator, ABC):
    """Base class of Gaussian generators that move Gaussians as SpacetimeGaussians does."""

    family = "4d"
    count_semantics = "upper-bound"

    origin: Tensor
    motion: Tensor
    rotation: Tensor
    omega: Tensor
    scale: Tensor
    opacity: Tensor
    temporal_centre: Tensor
    rate: Tensor
    features: Tensor

    def __init__(self, splats: SpacetimeSplats) -> None:
        super().__init__()
        for name in ("rotation", "omega", "temporal_centre", "features"):
            self.register_buffer(name, getattr(splats, name))
        # Planes [3, N], over which a row of times is contiguous.
        self.register_buffer("origin", splats.position.t().contiguous())
        self.register_buffer("motion", splats.motion.permute(1, 2, 0).contiguous())
        self.register_buffer("scale", torch.exp(splats.log_scale))
        self.register_buffer("opacity", torch.sigmoid(splats.logit_opacity))
        rate = torch.exp(-splats.log_duration.double()).clamp(max=_MAX_RATE)
        self.register_buffer("rate", rate.float())

    def moved(self, time: Float[Tensor, "1"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return time offsets, centres, opacities and covariances of the Gaussians at a given time.

        Of the covariances, the upper triangles are returned.
        """
        time_offset = time.reshape(1, 1) - self.temporal_centre
        distance = time_offset * self.rate
        opacity = self.opacity * torch.exp(-(distance * distance))
        row = time_offset.reshape(1, -1)
        linear_motion, quadratic_motion, cubic_motion = self.motion.unbind(0)
        position = (
            self.origin + row * (linear_motion + row * (quadratic_motion + row * cubic_motion))
        ).transpose(0, 1)
        rotation = [
            start + row * angular_velocity
            for start, angular_velocity in zip(
                planes_of(self.rotation), planes_of(self.omega), strict=True
            )
        ]
        covariance = stack_planes(covariance_planes(planes_of(self.scale), rotation))
        return time_offset, position, opacity, covariance
