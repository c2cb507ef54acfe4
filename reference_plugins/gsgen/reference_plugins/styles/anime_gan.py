"""The generator of AnimeGANv2, in the layout of its PyTorch version.

Chen et al. 2020, "AnimeGAN: A Novel Lightweight GAN for Photo Animation", with the inverted
residual blocks and layer norms of its second version.
"""

__all__ = ["AnimeGan", "AnimeGanOptions"]

from dataclasses import dataclass
from typing import final

import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.styles.style_transfer import StyleTransfer

_STRIDE = 4
_SLOPE = 0.2  # of the leaky rectifiers, below zero


@dataclass(frozen=True, slots=True, kw_only=True)
class AnimeGanOptions:
    """The sizes of the network; published ones have width 32 and four residual blocks."""

    width: int = 32
    blocks: int = 4
    align_corners: bool = True  # the first and last pixels stay where they are as the size grows


class _Conv(nn.Sequential):
    """A convolution over a mirrored image, a norm over all of it, and a leaky rectifier."""

    def __init__(
        self, inputs: int, outputs: int, kernel: int = 3, stride: int = 1, groups: int = 1
    ) -> None:
        # With a stride of two, only the right and lower edge are mirrored.
        padding = (0, 1, 0, 1) if stride == 2 else kernel // 2
        bias = groups > 1
        conv = nn.Conv2d(inputs, outputs, kernel, stride, groups=groups, bias=bias)
        norm = nn.GroupNorm(1, outputs)
        super().__init__(nn.ReflectionPad2d(padding), conv, norm, nn.LeakyReLU(_SLOPE))


class _InvertedResidual(nn.Module):
    """A 1×1 convolution to more channels, a depthwise one, and a 1×1 convolution back."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        inner = 2 * inputs
        self.layers = nn.Sequential(
            _Conv(inputs, inner, kernel=1),
            _Conv(inner, inner, groups=inner),
            nn.Conv2d(inner, outputs, 1, bias=False),
            nn.GroupNorm(1, outputs),
        )
        self.has_residual = inputs == outputs

    def forward(self, image: Tensor) -> Tensor:
        result: Tensor = self.layers(image)
        return image + result if self.has_residual else result


@final
class AnimeGan(StyleTransfer):
    """Two layers down, inverted residual blocks at a quarter of the size, two layers up."""

    source = "https://github.com/bryandlee/animegan2-pytorch"

    def __init__(
        self, options: AnimeGanOptions, size: tuple[int, int] | None, *, slider: bool = True
    ) -> None:
        super().__init__(size, slider=slider)
        c, self.options = options.width, options
        self.block_a = nn.Sequential(_Conv(3, c, 7), _Conv(c, 2 * c, stride=2), _Conv(2 * c, 2 * c))
        self.block_b = nn.Sequential(_Conv(2 * c, 4 * c, stride=2), _Conv(4 * c, 4 * c))
        residuals = [
            _InvertedResidual(8 * c if index else 4 * c, 8 * c) for index in range(options.blocks)
        ]
        self.block_c = nn.Sequential(_Conv(4 * c, 4 * c), *residuals, _Conv(8 * c, 4 * c))
        self.block_d = nn.Sequential(_Conv(4 * c, 4 * c), _Conv(4 * c, 4 * c))
        self.block_e = nn.Sequential(_Conv(4 * c, 2 * c), _Conv(2 * c, 2 * c), _Conv(2 * c, c, 7))
        self.out_layer = nn.Sequential(nn.Conv2d(c, 3, 1, bias=False), nn.Tanh())

    def redraw(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 H W"]:
        """Return the redrawn image, its sides rounded up to multiples of 4."""
        height, width = image.shape[2], image.shape[3]
        bottom, right = -height % _STRIDE, -width % _STRIDE
        if not self.options.align_corners and (self.size is None or bottom or right):
            image = F.pad(image, (0, right, 0, bottom), mode="replicate")
        fine = self.block_a(2 * image - 1)
        features = self.block_c(self.block_b(fine))
        features = self.block_d(self._enlarged(features, fine))
        result: Tensor = self.out_layer(self.block_e(self._enlarged(features, image)))
        return result * 0.5 + 0.5

    def _enlarged(self, features: Tensor, target: Tensor) -> Tensor:
        size = (target.shape[2], target.shape[3])
        return F.interpolate(
            features, size, mode="bilinear", align_corners=self.options.align_corners
        )

    def describe(self) -> str:
        """Return the method and the sizes of the network in a few words."""
        options = self.options
        return f"AnimeGANv2 of width {options.width}, {options.blocks} inverted residual blocks"
