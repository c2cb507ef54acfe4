"""The network of ESRGAN and Real-ESRGAN: residual-in-residual dense blocks.

Wang et al. 2018, "ESRGAN" (arXiv 1809.00219, section 3.1), without batch norms and with residuals
scaled by 0.2; Wang et al. 2021, "Real-ESRGAN" (arXiv 2107.10833, section 3.4), gives smaller scales
by gathering blocks of pixels into channels first.
"""

__all__ = ["RRDBNet", "RRDBOptions"]

from dataclasses import dataclass
from typing import final

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.enhancers.enhancer import ImageNetwork

_RESIDUAL_SCALE = 0.2
_SLOPE = 0.2  # of the leaky rectifiers, below zero
_UPSAMPLING = 4  # two layers double the size each


@dataclass(frozen=True, slots=True, kw_only=True)
class RRDBOptions:
    """The sizes of the network, as its weights tell them."""

    scale: int  # 4, 2 or 1
    width: int
    growth: int  # channels that each convolution of a dense block adds
    blocks: int


class _DenseBlock(nn.Module):
    """Five convolutions, each of which sees the results of all before it."""

    def __init__(self, width: int, growth: int) -> None:
        super().__init__()
        for index in range(1, 5):
            layer = nn.Conv2d(width + (index - 1) * growth, growth, 3, padding=1)
            self.add_module(f"conv{index}", layer)
        self.conv5 = nn.Conv2d(width + 4 * growth, width, 3, padding=1)

    def forward(self, image: Tensor) -> Tensor:
        features = [image]
        for index in range(1, 5):
            layer = self.get_submodule(f"conv{index}")
            features.append(F.leaky_relu(layer(torch.cat(features, 1)), _SLOPE))
        # The scale of the residual is folded into the weights.
        weight, bias = _RESIDUAL_SCALE * self.conv5.weight, _RESIDUAL_SCALE * _bias(self.conv5)
        return F.conv2d(torch.cat(features, 1), weight, bias, padding=1) + image


class _Block(nn.Module):
    """Three dense blocks, and a residual around them."""

    def __init__(self, width: int, growth: int) -> None:
        super().__init__()
        self.rdb1 = _DenseBlock(width, growth)
        self.rdb2 = _DenseBlock(width, growth)
        self.rdb3 = _DenseBlock(width, growth)

    def forward(self, image: Tensor) -> Tensor:
        features: Tensor = self.rdb3(self.rdb2(self.rdb1(image)))
        return features * _RESIDUAL_SCALE + image


@final
class RRDBNet(ImageNetwork):
    """Features at the image's size or a part of it, then two layers that double the size."""

    source = "https://github.com/xinntao/Real-ESRGAN"

    def __init__(self, options: RRDBOptions) -> None:
        super().__init__()
        self.options, self.scale = options, options.scale
        self.multiple = _UPSAMPLING // options.scale
        width = options.width
        self.conv_first = nn.Conv2d(3 * self.multiple**2, width, 3, padding=1)
        self.body = nn.Sequential(*(_Block(width, options.growth) for _ in range(options.blocks)))
        self.conv_body = nn.Conv2d(width, width, 3, padding=1)
        self.conv_up1 = nn.Conv2d(width, width, 3, padding=1)
        self.conv_up2 = nn.Conv2d(width, width, 3, padding=1)
        self.conv_hr = nn.Conv2d(width, width, 3, padding=1)
        self.conv_last = nn.Conv2d(width, 3, 3, padding=1)

    def forward(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 sh sw"]:
        """Return the enlarged image."""
        features = self._first_features(image)
        features = features + self.conv_body(self.body(features))
        for layer in (self.conv_up1, self.conv_up2):
            doubled = F.interpolate(features, scale_factor=2.0, mode="nearest")
            features = F.leaky_relu(layer(doubled), _SLOPE)
        result: Tensor = self.conv_last(F.leaky_relu(self.conv_hr(features), _SLOPE))
        return result

    def _first_features(self, image: Tensor) -> Tensor:
        """Convolve an image whose blocks of m × m pixels are channels.

        One convolution of stride m does both: weight[o, c, m y + v, m x + u] is that of tap (y, x)
        and of pixel (v, u) of the blocks.
        """
        m, weight = self.multiple, self.conv_first.weight
        taps = (
            weight.reshape(-1, 3, m, m, 3, 3).permute(0, 1, 4, 2, 5, 3).reshape(-1, 3, 3 * m, 3 * m)
        )
        return F.conv2d(image, taps, self.conv_first.bias, stride=m, padding=m)

    def describe(self) -> str:
        """Return the method and the sizes of the network in a few words."""
        options = self.options
        return f"Real-ESRGAN (RRDBNet) × {self.scale}, {options.blocks} blocks of width {options.width}"


def _bias(layer: nn.Conv2d) -> Tensor:
    assert layer.bias is not None
    return layer.bias
