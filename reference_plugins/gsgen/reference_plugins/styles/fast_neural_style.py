"""Fast neural style as PyTorch's examples train it: a network for each style.

Johnson et al. 2016, "Perceptual Losses for Real-Time Style Transfer", with instance norms (Ulyanov
et al. 2016) and repeated pixels in place of transposed convolutions. The network was trained on
colours from 0 to 255.
"""

__all__ = ["FastNeuralStyle"]

from typing import final

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.styles.style_transfer import StyleTransfer

_LEVELS = 255.0


class _Conv(nn.Module):
    """A convolution over an image whose edge is mirrored."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1) -> None:
        super().__init__()
        self.padding = kernel // 2
        self.conv2d = nn.Conv2d(inputs, outputs, kernel, stride)

    def forward(self, image: Tensor) -> Tensor:
        result: Tensor = self.conv2d(F.pad(image, (self.padding,) * 4, mode="reflect"))
        return result


class _Residual(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1, self.conv2 = _Conv(channels, channels, 3), _Conv(channels, channels, 3)
        self.in1 = nn.InstanceNorm2d(channels, affine=True)
        self.in2 = nn.InstanceNorm2d(channels, affine=True)

    def forward(self, image: Tensor) -> Tensor:
        features = torch.relu(self.in1(self.conv1(image)))
        result: Tensor = self.in2(self.conv2(features)) + image
        return result


@final
class FastNeuralStyle(StyleTransfer):
    """Two layers down, residual blocks at a quarter of the size, two layers up.

    The layers at the ends take and give 0 … 255; that is folded into their weights.
    """

    source = "https://github.com/pytorch/examples"
    in1: nn.InstanceNorm2d
    in2: nn.InstanceNorm2d
    in3: nn.InstanceNorm2d
    in4: nn.InstanceNorm2d
    in5: nn.InstanceNorm2d

    def __init__(
        self, channels: int, blocks: int, size: tuple[int, int] | None, *, slider: bool = True
    ) -> None:
        super().__init__(size, slider=slider)
        c, self.blocks = channels, blocks
        self.conv1, self.conv2, self.conv3 = _Conv(3, c, 9), _Conv(c, 2 * c, 3, 2), _Conv(2 * c, 4 * c, 3, 2)  # fmt: skip
        for index in range(1, blocks + 1):
            self.add_module(f"res{index}", _Residual(4 * c))
        self.deconv1, self.deconv2 = _Conv(4 * c, 2 * c, 3), _Conv(2 * c, c, 3)
        self.deconv3 = _Conv(c, 3, 9)
        for index, width in enumerate((c, 2 * c, 4 * c, 2 * c, c), 1):
            self.add_module(f"in{index}", nn.InstanceNorm2d(width, affine=True))

    def redraw(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 H W"]:
        """Return the redrawn image, its sides rounded up to multiples of 4."""
        features = torch.relu(self.in1(_scaled(self.conv1, image, inputs=_LEVELS)))
        features = torch.relu(self.in2(self.conv2(features)))
        features = torch.relu(self.in3(self.conv3(features)))
        for index in range(1, self.blocks + 1):
            features = self.get_submodule(f"res{index}")(features)
        for layer, norm in ((self.deconv1, self.in4), (self.deconv2, self.in5)):
            doubled = F.interpolate(features, scale_factor=2.0, mode="nearest")
            features = torch.relu(norm(layer(doubled)))
        return _scaled(self.deconv3, features, outputs=1 / _LEVELS).clamp(0.0, 1.0)

    def describe(self) -> str:
        """Return the method and the sizes of the network in a few words."""
        width = self.conv1.conv2d.out_channels
        return f"fast neural style of width {width}, {self.blocks} residual blocks"


def _scaled(layer: _Conv, image: Tensor, inputs: float = 1.0, outputs: float = 1.0) -> Tensor:
    """Apply a layer whose input and output are scaled."""
    conv = layer.conv2d
    assert conv.bias is not None
    padded = F.pad(image, (layer.padding,) * 4, mode="reflect")
    return F.conv2d(padded, conv.weight * (inputs * outputs), conv.bias * outputs, conv.stride)
