"""Decodes the full model of SpacetimeGaussians exactly: in each pixel, from blended features.

Li et al. 2024, section 3.3: nine features of each Gaussian are blended like colours over black, and
two dense layers turn those of a pixel, with the ray through it, into the pixel's colour. A
generator emits three of the features at a time, scaled to [0, 1]; the decoder undoes the scaling.
"""

__all__ = ["FeaturePasses", "FeatureScale", "PixelDecoder"]

from dataclasses import dataclass, replace
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.spacetime.moving_splats import MovingSplats
from gsgen.reference_plugins.spacetime.spacetime_checkpoint import FeatureDecoder, SpacetimeSplats
from gsgen.sdk import Gaussians, PostProcess, inputs

_FEATURE_GROUPS = 3  # albedo, specular features, features that grow with dt
_FEATURE_COUNT = 9
_CONDITIONING_SIZE = 9  # of a pixel: the features of passes 1 and 2, and the direction of the ray
_MAX_COORDINATE = 1e4  # bound of the camera's coordinates, in the scene's unit


@dataclass(frozen=True, slots=True)
class FeatureScale:
    """Bounds, which include 0, of SpacetimeGaussians' nine features over times from 0 to 1."""

    low: Float[Tensor, "9"]
    width: Float[Tensor, "9"]

    @classmethod
    def of(cls, splats: SpacetimeSplats) -> "FeatureScale":
        """Compute the bounds of features over time; those linear in time are extreme at 0 or 1."""
        constant_features, linear_features = splats.features[:, :6], splats.features[:, 6:]
        end_features = [linear_features * (end - splats.temporal_centre) for end in (0.0, 1.0)]
        low = torch.cat([constant_features.amin(dim=0), torch.cat(end_features).amin(dim=0)]).clamp(
            max=0.0
        )
        high = torch.cat(
            [constant_features.amax(dim=0), torch.cat(end_features).amax(dim=0)]
        ).clamp(min=0.0)
        # A feature that is zero everywhere is scaled by 1.
        width = torch.where(high > low, high - low, torch.ones_like(low))
        return cls(low, width)


@final
class FeaturePasses(MovingSplats):
    """SpacetimeGaussians' full model as a generator, whose colours are three of nine features.

    The input ``features`` selects them: 0 the albedo, 1 the specular features, 2 those that grow
    with time. A runtime draws the three over transparent black, for :class:`PixelDecoder`.
    """

    low: Tensor
    feature_gain: Tensor

    def __init__(self, splats: SpacetimeSplats, time: Input | None = None) -> None:
        super().__init__(splats)
        select_input = inputs.control(
            "features", range=(0, _FEATURE_GROUPS - 1), default=0.0, label="Features"
        )
        self.inputs = (time or inputs.time(), select_input)
        scale = FeatureScale.of(splats)
        self.register_buffer("low", scale.low.reshape(_FEATURE_GROUPS, 1, 3))
        self.register_buffer("feature_gain", (1 / scale.width).reshape(_FEATURE_GROUPS, 1, 3))

    def forward(self, time: Float[Tensor, "1"], features: Float[Tensor, "1"]) -> Gaussians:
        """Return the Gaussians at a time, coloured by the three features that an input selects."""
        time_offset, position, opacity, covariance = self.moved(time)
        groups = [self.features[:, i : i + 3] for i in range(0, _FEATURE_COUNT, 3)]
        groups[-1] = time_offset * groups[-1]
        rgb = torch.zeros_like(position)
        for index, group in enumerate(groups):
            # 1 for the selected group, 0 for the others; numbers between two groups blend them.
            share = torch.relu(1 - (features - index).abs())
            decoder_input = (group - self.low[index]) * self.feature_gain[index]
            rgb = rgb + share * decoder_input.clamp(0.0, 1.0)
        return Gaussians(position=position, opacity=opacity, covariance=covariance, rgb=rgb)


@final
class PixelDecoder(PostProcess):
    """SpacetimeGaussians' decoder: a post-process model from blended features to colours.

    The image is pass 0 with alpha. ``conditioning`` has for each pixel, row by row, the colours of
    passes 1 and 2, not multiplied by alpha, and the unit direction of the ray; ``origin`` is the
    camera's centre. The result is opaque: the method makes a colour of the empty background, too.
    """

    family = "4d"
    channels = 4

    low: Tensor
    width: Tensor
    hidden: Tensor
    camera: Tensor
    color: Tensor

    def __init__(self, decoder: FeatureDecoder, scale: FeatureScale, size: tuple[int, int]) -> None:
        super().__init__()
        self.size = size
        origin = replace(
            inputs.conditioning(1, 3, "origin"), range=(-_MAX_COORDINATE, _MAX_COORDINATE)
        )
        pixels = inputs.conditioning(size[0] * size[1], _CONDITIONING_SIZE)
        self.inputs = (inputs.image(4, size), pixels, origin)
        self.activation = decoder.activation
        self.register_buffer("low", scale.low.reshape(1, _FEATURE_COUNT, 1))
        self.register_buffer("width", scale.width.reshape(1, _FEATURE_COUNT, 1))
        # Columns: specular features, those that change with time, camera, ray.
        camera, ray = decoder.hidden[:, 6:9], decoder.hidden[:, 9:]
        self.register_buffer("hidden", torch.cat([decoder.hidden[:, :6], ray], dim=1))
        self.register_buffer("camera", camera)
        self.register_buffer("color", decoder.color)

    def forward(
        self,
        image: Float[Tensor, "1 4 h w"],
        conditioning: Float[Tensor, "1 n 9"],
        origin: Float[Tensor, "1 1 3"],
    ) -> Float[Tensor, "1 4 h w"]:
        """Return the colours of the pixels, [1, 4, h, w], with an alpha of 1."""
        height, width = self.size
        pixels = image.reshape(1, 4, -1)
        known = conditioning.to(image.dtype).transpose(1, 2)
        alpha = pixels[:, 3:]
        # Colours of an image are not multiplied by alpha; blended features are.
        decoder_input = torch.cat([pixels[:, :3], known[:, :6]], dim=1)
        features = alpha * (self.low + self.width * decoder_input)
        hidden = self.hidden @ torch.cat([features[:, 3:], known[:, 6:]], dim=1)
        hidden = hidden + self.camera @ origin.to(image.dtype).transpose(1, 2)
        color = features[:, :3] + self.color @ torch.relu(hidden)
        color = torch.sigmoid(color) if self.activation == "sigmoid" else color.clamp(0.0, 1.0)
        return torch.cat([color, torch.ones_like(alpha)], dim=1).reshape(1, 4, height, width)
