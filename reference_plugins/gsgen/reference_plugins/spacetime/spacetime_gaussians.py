"""A Gaussian generator from a SpacetimeGaussians checkpoint, with a colour per Gaussian.

Colours of the lite model are constant; those of the full model are decoded from features.
"""

__all__ = ["SpacetimeGaussians", "color_range"]

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.spacetime.moving_splats import MovingSplats
from gsgen.reference_plugins.spacetime.spacetime_checkpoint import FeatureDecoder, SpacetimeSplats
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.sdk import Gaussians, inputs
from gsgen.sdk.math import camera_centre, safe_normalize

_FEATURE_COUNT = 3


def color_range(colors: Float[Tensor, "n 3"]) -> tuple[float, float] | None:
    """Return the range of colours, rounded to tenths, if any is outside [0, 1]; else None."""
    low, high = float(colors.min()), float(colors.max())
    if low >= 0 and high <= 1:
        return None
    time_samples = torch.tensor([10 * min(low, 0.0), 10 * max(high, 1.0)], dtype=torch.float64)
    return float(time_samples[0].floor()) / 10, float(time_samples[1].ceil()) / 10


@final
class SpacetimeGaussians(MovingSplats):
    """SpacetimeGaussians as a generator model, whose Gaussians follow polynomials of time.

    With a ``decoder``, colours are decoded for each Gaussian, along the ray through its centre.
    The method decodes the blended features of each pixel: the result is an approximation.
    """

    def __init__(
        self,
        splats: SpacetimeSplats,
        decoder: FeatureDecoder | None = None,
        time: Input | None = None,
    ) -> None:
        super().__init__(splats)
        moment = time or inputs.time()
        self.inputs = (moment,) if decoder is None else (moment, inputs.view())
        self.activation = None if decoder is None else decoder.activation
        self.hidden = self.out = None
        if decoder is None:
            self.color_range = color_range(splats.features)
        else:
            self.hidden = Dense(decoder.hidden, torch.zeros(len(decoder.hidden)))
            self.out = Dense(decoder.color, torch.zeros(3))

    def forward(self, time: Float[Tensor, "1"], camera: Tensor | None = None) -> Gaussians:
        """Return the Gaussians at a given time, with colours as the camera sees them."""
        time_offset, position, opacity, covariance = self.moved(time)
        rgb = (
            self.features if camera is None else self._decode_colors(position, time_offset, camera)
        )
        return Gaussians(position=position, opacity=opacity, covariance=covariance, rgb=rgb)

    def _decode_colors(
        self,
        position: Float[Tensor, "n 3"],
        time_offset: Float[Tensor, "n 1"],
        camera: Float[Tensor, "4 4"],
    ) -> Float[Tensor, "n 3"]:
        """Decode the features of each Gaussian along the ray from the camera to its centre."""
        assert self.hidden is not None
        assert self.out is not None
        origin = camera_centre(camera)[None]
        direction = safe_normalize(position - origin)
        base_colors = self.features[:, :_FEATURE_COUNT]
        specular = self.features[:, _FEATURE_COUNT : 2 * _FEATURE_COUNT]
        changing_features = time_offset * self.features[:, 2 * _FEATURE_COUNT :]
        # Each part of the input has its own product, which saves copying them into a wide tensor.
        weights = torch.split(self.hidden.weight, _FEATURE_COUNT)
        hidden = specular @ weights[0] + changing_features @ weights[1] + direction @ weights[3]
        color: Tensor = base_colors + self.out(torch.relu(hidden + origin @ weights[2]))
        return torch.sigmoid(color) if self.activation == "sigmoid" else color.clamp(0.0, 1.0)
