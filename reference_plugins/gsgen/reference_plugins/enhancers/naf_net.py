"""NAFNet: a U-Net that restores images without activation functions.

Chen et al. 2022, "Simple Baselines for Image Restoration" (arXiv 2204.04676, section 4).
"""

__all__ = ["NAFNet", "NAFNetOptions"]

from dataclasses import dataclass
from typing import final

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.enhancers.enhancer import ImageNetwork

_EPSILON = 1e-6  # of the layer norms, below the square root


@dataclass(frozen=True, slots=True, kw_only=True)
class NAFNetOptions:
    """The sizes of the network, as its weights tell them."""

    width: int
    encoder: tuple[int, ...]  # blocks of each level, the finest first
    middle: int
    decoder: tuple[int, ...]  # the coarsest first


class _Norm(nn.Module):
    """The weights of a layer norm over channels; :func:`_normalised` computes it without them."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(width))
        self.bias = nn.Parameter(torch.zeros(width))


class _Block(nn.Module):
    """Two residual steps: gated depthwise convolutions with channel attention, gated layers.

    Linear steps are folded: a norm's weight and bias into the 1×1 convolution after it, and the
    scale of a residual into the one before it.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(width, 2 * width, 1)
        self.conv2 = nn.Conv2d(2 * width, 2 * width, 3, padding=1, groups=2 * width)
        self.conv3 = nn.Conv2d(width, width, 1)
        self.sca = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Conv2d(width, width, 1))
        self.conv4 = nn.Conv2d(width, 2 * width, 1)
        self.conv5 = nn.Conv2d(width, width, 1)
        self.norm1, self.norm2 = _Norm(width), _Norm(width)
        self.beta = nn.Parameter(torch.zeros(1, width, 1, 1))
        self.gamma = nn.Parameter(torch.zeros(1, width, 1, 1))

    def forward(self, image: Tensor) -> Tensor:
        gated = _gate(self.conv2(_after_norm(self.conv1, self.norm1, image)))
        middle = image + _scaled(self.conv3, self.beta, gated * self.sca(gated))
        gated = _gate(_after_norm(self.conv4, self.norm2, middle))
        return middle + _scaled(self.conv5, self.gamma, gated)


def _gate(features: Tensor) -> Tensor:
    first, second = features.chunk(2, dim=1)
    return first * second


def _after_norm(layer: nn.Conv2d, norm: _Norm, image: Tensor) -> Tensor:
    """Return layer(norm(image)): W (w n + b) + c = (W w) n + (W b + c)."""
    centered = image - image.mean(1, keepdim=True)
    deviation = (centered.square().mean(1, keepdim=True) + _EPSILON).sqrt()
    matrix = layer.weight[:, :, 0, 0]
    weight = (matrix * norm.weight)[:, :, None, None]
    return F.conv2d(centered / deviation, weight, matrix @ norm.bias + _bias(layer))


def _scaled(layer: nn.Conv2d, scale: Tensor, image: Tensor) -> Tensor:
    """Return scale · layer(image)."""
    factors = scale.reshape(-1)
    return F.conv2d(image, layer.weight * factors[:, None, None, None], _bias(layer) * factors)


def _bias(layer: nn.Conv2d) -> Tensor:
    assert layer.bias is not None
    return layer.bias


@final
class NAFNet(ImageNetwork):
    """A U-Net of such blocks, and the image as a residual."""

    source = "https://github.com/megvii-research/NAFNet"
    scale = 1
    padding = "constant"

    def __init__(self, options: NAFNetOptions) -> None:
        super().__init__()
        self.options, self.multiple = options, 2 ** len(options.encoder)
        width = options.width
        self.intro = nn.Conv2d(3, width, 3, padding=1)
        self.ending = nn.Conv2d(width, 3, 3, padding=1)
        self.encoders, self.downs = nn.ModuleList(), nn.ModuleList()
        self.decoders, self.ups = nn.ModuleList(), nn.ModuleList()
        for count in options.encoder:
            self.encoders.append(_blocks(width, count))
            self.downs.append(nn.Conv2d(width, 2 * width, 2, stride=2))
            width *= 2
        self.middle_blks = _blocks(width, options.middle)
        for count in options.decoder:
            layer = nn.Conv2d(width, 2 * width, 1, bias=False)
            self.ups.append(nn.Sequential(layer, nn.PixelShuffle(2)))
            width //= 2
            self.decoders.append(_blocks(width, count))

    def forward(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 h w"]:
        """Return the restored image."""
        features, skipped = self.intro(image), list[Tensor]()
        for blocks, down in zip(self.encoders, self.downs, strict=True):
            skipped.append(blocks(features))
            features = down(skipped[-1])
        features = self.middle_blks(features)
        for blocks, up in zip(self.decoders, self.ups, strict=True):
            features = blocks(up(features) + skipped.pop())
        result: Tensor = self.ending(features) + image
        return result

    def describe(self) -> str:
        """Return the method and the sizes of the network in a few words."""
        options = self.options
        counts = "+".join(map(str, (*options.encoder, options.middle, *options.decoder)))
        return f"NAFNet of width {options.width}, {counts} blocks"


def _blocks(width: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(_Block(width) for _ in range(count)))
