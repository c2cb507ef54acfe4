"""AdaIN: one network for all styles, which are pictures.

Huang and Belongie 2017, "Arbitrary Style Transfer in Real-time with Adaptive Instance
Normalization" (arXiv 1703.06868, equation 8): features of the image get the mean and the deviation
of each channel of the style picture's features. The style's are computed at the export.
"""

__all__ = ["AdaIn", "decoder_of_width", "encoder_of_width"]

from typing import final

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.styles.style_transfer import StyleTransfer

_EPSILON = 1e-5  # added to variances
# Convolutions of VGG-19 up to relu4_1, in multiples of the width of the first; P halves the size.
_ENCODER = (1, 1, "P", 2, 2, "P", 4, 4, 4, 4, "P", 8)
# Those of the decoder; U doubles the size, and the last convolution gives colours.
_DECODER = (4, "U", 4, 4, 4, 2, "U", 2, 1, "U", 1)


class _HalveSize(nn.Module):
    """The largest of two by two pixels; of an odd side the last pixels count twice."""

    def forward(self, image: Tensor) -> Tensor:
        bottom, right = image.shape[2] % 2, image.shape[3] % 2
        return F.max_pool2d(F.pad(image, (0, right, 0, bottom), mode="replicate"), 2)


def encoder_of_width(width: int) -> nn.Sequential:
    """Return VGG-19 up to relu4_1 with untrained weights; layers count as in published files."""
    layers: list[nn.Module] = [nn.Conv2d(3, 3, 1)]
    channels = 3
    for step in _ENCODER:
        if isinstance(step, int):
            convolution = nn.Conv2d(channels, channels := step * width, 3)
            layers += [nn.ReflectionPad2d(1), convolution, nn.ReLU()]
        else:
            layers.append(_HalveSize())
    return nn.Sequential(*layers)


def decoder_of_width(width: int) -> nn.Sequential:
    """Return the decoder from relu4_1 to colours, with untrained weights."""
    layers: list[nn.Module] = []
    channels = 8 * width
    for step in _DECODER:
        if isinstance(step, int):
            convolution = nn.Conv2d(channels, channels := step * width, 3)
            layers += [nn.ReflectionPad2d(1), convolution, nn.ReLU()]
        else:
            layers.append(nn.Upsample(scale_factor=2.0, mode="nearest"))
    return nn.Sequential(*layers, nn.ReflectionPad2d(1), nn.Conv2d(channels, 3, 3))


@final
class AdaIn(StyleTransfer):
    """Encoder, exchange of means and deviations, decoder; the slider mixes features."""

    source = "https://github.com/naoto0804/pytorch-AdaIN"

    style_mean: Tensor
    style_deviation: Tensor

    def __init__(
        self,
        encoder: nn.Sequential,
        decoder: nn.Sequential,
        style: Float[Tensor, "1 3 h w"],
        size: tuple[int, int] | None,
        *,
        slider: bool = True,
    ) -> None:
        super().__init__(size, slider=slider)
        self.encoder, self.decoder = encoder.eval(), decoder.eval()
        with torch.no_grad():
            mean, deviation = _mean_and_deviation(self.encoder(style))
        self.register_buffer("style_mean", mean)
        self.register_buffer("style_deviation", deviation)

    def redraw(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 H W"]:
        """Return the redrawn image, its sides rounded up to multiples of 8."""
        return self._decoded(self.encoder(image), None)

    def forward(
        self, image: Float[Tensor, "1 3 h w"], style: Float[Tensor, "1"] | None = None
    ) -> Float[Tensor, "1 3 h w"]:
        """Return the image in the style of the picture; ``style`` mixes features, not images."""
        redrawn = self._decoded(self.encoder(image), style)
        return redrawn[:, :, : image.shape[2], : image.shape[3]]

    def _decoded(self, features: Tensor, share: Tensor | None) -> Tensor:
        mean, deviation = _mean_and_deviation(features)
        styled = (features - mean) / deviation * self.style_deviation + self.style_mean
        if share is not None:
            styled = features + share.to(features.dtype).reshape(1, 1, 1, 1) * (styled - features)
        result: Tensor = self.decoder(styled)
        return result.clamp(0.0, 1.0)

    def describe(self) -> str:
        """Return the method and the sizes of the network in a few words."""
        return f"AdaIN of {self.style_mean.shape[1]} channels"


def _mean_and_deviation(
    features: Float[Tensor, "1 c h w"],
) -> tuple[Float[Tensor, "1 c 1 1"], Float[Tensor, "1 c 1 1"]]:
    """Return the mean of each channel and the square root of its unbiased variance."""
    mean = features.mean((2, 3), keepdim=True)
    count = features.shape[2] * features.shape[3]
    variance = (features - mean).square().sum((2, 3), keepdim=True) / (count - 1)
    return mean, (variance + _EPSILON).sqrt()
