"""SpacetimeGaussians: polynomial motion, and opacity that rises and falls once.

Li et al. 2024, "Spacetime Gaussian Feature Splatting for Real-Time Dynamic View Synthesis",
equations 5 to 8: with dt = t − μ the centre is x + Σ bₖ dtᵏ, the rotation q + dt ω, and the
opacity σ(o) exp(−(dt/s)²). Colours of the lite model are constant; those of the full model are
decoded from features.
"""

__all__ = ["SpacetimeGaussians", "color_range"]

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.spacetime.spacetime_checkpoint import FeatureDecoder, SpacetimeSplats
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.reference_plugins.tensors.planes import covariance_planes, planes_of, stacked
from gsgen.sdk import GaussianGenerator, Gaussians, inputs
from gsgen.sdk.math import camera_centre, safe_normalize

# 1 / duration is at most this, so that its square, times a squared time, is finite in float32.
_MAX_RATE = 1e15
_FEATURES = 3


def color_range(colors: Float[Tensor, "n 3"]) -> tuple[float, float] | None:
    """Return the range of colours, rounded to tenths, if any is outside [0, 1]; else None."""
    low, high = float(colors.min()), float(colors.max())
    if low >= 0 and high <= 1:
        return None
    tenths = torch.tensor([10 * min(low, 0.0), 10 * max(high, 1.0)], dtype=torch.float64)
    return float(tenths[0].floor()) / 10, float(tenths[1].ceil()) / 10


@final
class SpacetimeGaussians(GaussianGenerator):
    """SpacetimeGaussians: a generator whose Gaussians follow polynomials of time.

    With a ``decoder``, colours are decoded for each Gaussian, along the ray through its centre.
    The method decodes the blended features of each pixel: the result is an approximation.
    """

    family = "4d"
    count_semantics = "upper-bound"

    position: Tensor
    motion: Tensor
    rotation: Tensor
    omega: Tensor
    scale: Tensor
    opacity: Tensor
    temporal_centre: Tensor
    rate: Tensor
    features: Tensor

    def __init__(
        self,
        splats: SpacetimeSplats,
        decoder: FeatureDecoder | None = None,
        time: Input | None = None,
    ) -> None:
        super().__init__()
        moment = time or inputs.time()
        self.inputs = (moment,) if decoder is None else (moment, inputs.view())
        self.activation = None if decoder is None else decoder.activation
        for name in ("position", "rotation", "omega", "temporal_centre", "features"):
            self.register_buffer(name, getattr(splats, name))
        self.register_buffer("motion", splats.motion.flatten(1))
        self.register_buffer("scale", torch.exp(splats.log_scale))
        self.register_buffer("opacity", torch.sigmoid(splats.logit_opacity))
        rate = torch.exp(-splats.log_duration.double()).clamp(max=_MAX_RATE)
        self.register_buffer("rate", rate.float())
        self.hidden = self.out = None
        if decoder is None:
            self.color_range = color_range(splats.features)
        else:
            self.hidden = Dense(decoder.hidden, torch.zeros(len(decoder.hidden)))
            self.out = Dense(decoder.color, torch.zeros(3))

    def forward(self, time: Float[Tensor, "1"], camera: Tensor | None = None) -> Gaussians:
        """Return the Gaussians at a given time, with colours as the camera sees them."""
        dt = time.reshape(1, 1) - self.temporal_centre
        first, second, third = (self.motion[:, i : i + 3] for i in (0, 3, 6))
        position = self.position + dt * (first + dt * (second + dt * third))
        distance = dt * self.rate
        opacity = self.opacity * torch.exp(-(distance * distance))
        row = dt.reshape(1, -1)
        rotation = [
            start + row * change
            for start, change in zip(planes_of(self.rotation), planes_of(self.omega), strict=True)
        ]
        covariance = stacked(covariance_planes(planes_of(self.scale), rotation))
        rgb = self.features if camera is None else self._decoded(position, dt, camera)
        return Gaussians(position=position, opacity=opacity, covariance=covariance, rgb=rgb)

    def _decoded(
        self, position: Float[Tensor, "n 3"], dt: Float[Tensor, "n 1"], camera: Float[Tensor, "4 4"]
    ) -> Float[Tensor, "n 3"]:
        """Decode the features of each Gaussian along the ray from the camera to its centre."""
        assert self.hidden is not None
        assert self.out is not None
        origin = camera_centre(camera)[None]
        direction = safe_normalize(position - origin)
        albedo = self.features[:, :_FEATURES]
        specular = self.features[:, _FEATURES : 2 * _FEATURES]
        changing = dt * self.features[:, 2 * _FEATURES :]
        # Each part of the input has its own product, which saves copying them into a wide tensor.
        weights = torch.split(self.hidden.weight, _FEATURES)
        hidden = specular @ weights[0] + changing @ weights[1] + direction @ weights[3]
        color: Tensor = albedo + self.out(torch.relu(hidden + origin @ weights[2]))
        return torch.sigmoid(color) if self.activation == "sigmoid" else color.clamp(0.0, 1.0)
