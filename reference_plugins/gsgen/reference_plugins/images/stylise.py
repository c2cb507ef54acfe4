"""A feed-forward network that renders an image in another style.

Johnson et al. 2016, "Perceptual Losses for Real-Time Style Transfer", with the instance norms of
Ulyanov et al. 2016, "Instance Normalization: The Missing Ingredient for Fast Stylization", and
nearest upsampling in place of transposed convolutions (Odena et al. 2016). The result is
blended with the image, by a weight that may be an input.
"""

__all__ = ["Stylise", "StyliseOptions"]

from dataclasses import dataclass
from typing import final

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.styles.style_transfer import StyleTransfer

_PADDING_STRIDE = 4


@dataclass(frozen=True, slots=True)
class StyliseOptions:
    """The shape of the style transfer network: widths and number of blocks."""

    channels: int = 16  # channels of the first convolution; each of the next two doubles them
    blocks: int = 3  # residual blocks at a quarter of the size


class _Block(nn.Module):
    """A convolution with edge padding, and an instance norm."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1) -> None:
        super().__init__()
        self.padding = kernel // 2
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride=stride)
        self.norm = nn.InstanceNorm2d(outputs, affine=True)

    def forward(self, image: Tensor) -> Tensor:
        output: Tensor = self.norm(self.conv(F.pad(image, (self.padding,) * 4, mode="replicate")))
        return output


class _ResidualBlock(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = _Block(channels, channels, 3)
        self.second = _Block(channels, channels, 3)

    def forward(self, image: Tensor) -> Tensor:
        output: Tensor = image + self.second(torch.relu(self.first(image)))
        return output


@final
class Stylise(StyleTransfer):
    """The style transfer network: downsampling, residual blocks, upsampling; images are 0 … 1."""

    def __init__(
        self, options: StyliseOptions, size: tuple[int, int] | None, *, slider: bool = True
    ) -> None:
        super().__init__(size, slider=slider)
        c = options.channels
        self.down = nn.ModuleList(
            [_Block(3, c, 9), _Block(c, 2 * c, 3, 2), _Block(2 * c, 4 * c, 3, 2)]
        )
        self.middle = nn.ModuleList(_ResidualBlock(4 * c) for _ in range(options.blocks))
        self.up = nn.ModuleList([_Block(4 * c, 2 * c, 3), _Block(2 * c, c, 3)])
        self.last = nn.Conv2d(c, 3, 9)

    def redraw(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 H W"]:
        """Return the redrawn image, its sides rounded up to multiples of 4."""
        bottom_padding = -image.shape[2] % _PADDING_STRIDE
        right_padding = -image.shape[3] % _PADDING_STRIDE
        features = 2 * image - 1
        if self.size is None or bottom_padding or right_padding:
            features = F.pad(features, (0, right_padding, 0, bottom_padding), mode="replicate")
        for block in self.down:
            features = torch.relu(block(features))
        for block in self.middle:
            features = block(features)
        for block in self.up:
            features = torch.relu(block(F.interpolate(features, scale_factor=2.0, mode="nearest")))
        return torch.sigmoid(self.last(F.pad(features, (4,) * 4, mode="replicate")))

    def describe(self) -> str:
        """Return the sizes of the network in a few words."""
        return f"width {self.last.in_channels}, {len(self.middle)} residual blocks"
