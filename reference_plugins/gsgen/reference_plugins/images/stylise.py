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

from gsgen.sdk import PostProcess, inputs

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
class Stylise(PostProcess):
    """The style transfer network: downsampling, residual blocks, upsampling; images are 0 … 1."""

    family = "stylisation"

    def __init__(
        self, options: StyliseOptions, size: tuple[int, int] | None, *, slider: bool = True
    ) -> None:
        super().__init__()
        c = options.channels
        self.down = nn.ModuleList(
            [_Block(3, c, 9), _Block(c, 2 * c, 3, 2), _Block(2 * c, 4 * c, 3, 2)]
        )
        self.middle = nn.ModuleList(_ResidualBlock(4 * c) for _ in range(options.blocks))
        self.up = nn.ModuleList([_Block(4 * c, 2 * c, 3), _Block(2 * c, c, 3)])
        self.last = nn.Conv2d(c, 3, 9)
        self.size = size
        style_share = inputs.control("style", range=(0.0, 1.0), default=1.0, label="Style")
        self.inputs = [inputs.image(3, size), *([style_share] if slider else [])]

    def forward(
        self, image: Float[Tensor, "1 3 h w"], style: Float[Tensor, "1"] | None = None
    ) -> Float[Tensor, "1 3 h w"]:
        """Return the image in the style that the network was trained for."""
        height, width = image.shape[2], image.shape[3]
        bottom_padding, right_padding = -height % _PADDING_STRIDE, -width % _PADDING_STRIDE
        features = 2 * image - 1
        if self.size is None or bottom_padding or right_padding:
            features = F.pad(features, (0, right_padding, 0, bottom_padding), mode="replicate")
        for block in self.down:
            features = torch.relu(block(features))
        for block in self.middle:
            features = block(features)
        for block in self.up:
            features = torch.relu(block(F.interpolate(features, scale_factor=2.0, mode="nearest")))
        styled_image = torch.sigmoid(self.last(F.pad(features, (4,) * 4, mode="replicate")))
        styled_image = styled_image[:, :, :height, :width]
        if style is None:
            return styled_image
        return image + style.to(image.dtype).reshape(1, 1, 1, 1) * (styled_image - image)
