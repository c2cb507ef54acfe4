"""Weights that do something to an image and that nobody trained: they are set by formula.

Most of a network is switched off: a residual block whose second convolution is zero hands its input
on. What is left is a path that can be followed, and noted at each step below.
"""

__all__ = ["BINOMIAL", "Weights", "draw_outlines", "take_off_noise"]

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.diffusion.unet import UNet
from gsgen.reference_plugins.images.stylise import Stylise

_RGB = 3
_LIMIT = 1.2  # standard deviations of fine detail; more than that is an edge, and stays
_STEEP = 3.0  # how sharply SiLU bends, to pass for a ReLU
_LIGHT = torch.tensor([0.3, 0.6, 0.1])
BINOMIAL = torch.tensor([[1.0, 2.0, 1.0], [2.0, 4.0, 2.0], [1.0, 2.0, 1.0]]) / 16


def take_off_noise(unet: UNet) -> None:
    """Make a U-Net of two levels take fine detail of little contrast for noise.

    The upper level keeps the image, the lower one a blurred copy; their difference is normalised
    by the last GroupNorm to variance 1, as noise has it, and cut at ±1.2 by two SiLU.

    Args:
        unet: Of 3 channels to 3, two levels, one layer, and 8 channels in 4 groups at the upper.

    Raises:
        ConfigInvalid: It is of another shape.
    """
    options = unet.options
    seen = (options.inputs, options.outputs, len(options.channels), options.layers)
    if seen != (_RGB, _RGB, 2, 1) or (options.channels[0], options.groups) != (8, 4):
        raise ConfigInvalid(f"cannot be set by hand: {options}", where="unet")
    weights = Weights(unet)
    weights("conv_in", _centre)
    weights("down_blocks.0.downsamplers.0.conv", _blur)
    weights("down_blocks.1.resnets.0.conv_shortcut", _centre)
    for name in ("up_blocks.0.resnets.0", "up_blocks.0.resnets.1", "up_blocks.1.resnets.1"):
        weights(f"{name}.conv_shortcut", _all_on)  # what came from the side is left out
    weights("up_blocks.0.upsamplers.0.conv", _blur)
    blurred = options.channels[1]
    difference = weights["up_blocks.1.resnets.0.conv_shortcut.weight"]
    norm = weights["conv_norm_out.weight"], weights["conv_norm_out.bias"]
    out = weights["conv_out.weight"]
    for color in range(_RGB):  # a group of two for each colour: both are the difference
        pair = slice(2 * color, 2 * color + 2)
        difference[pair, blurred + color], difference[pair, color] = 1.0, -1.0
        norm[0][pair], norm[1][pair] = _STEEP, _STEEP * torch.tensor([_LIMIT, -_LIMIT])
        out[color, pair, 1, 1] = torch.tensor([1.0, -1.0]) / _STEEP
    weights["conv_out.bias"][:] = -_LIMIT


def draw_outlines(network: Stylise) -> None:
    """Make a stylisation network draw on white paper: what is bright in its colour, with outlines.

    Channels carry red, green, blue, brightness, and how much brighter or darker a pixel is than what
    is around it, each standardised by the norms; the last layer weighs them.

    Raises:
        ConfigInvalid: The network has fewer than six channels.
    """
    channels = network.last.in_channels
    if channels < 6:
        raise ConfigInvalid(f"{channels} channels, wanted 6 at least", where="channels")
    weights = Weights(network)
    weights("down.0.conv", _color_and_contrast)
    for name in ("down.1", "down.2", "up.0", "up.1"):
        weights(f"{name}.conv", _blur)
    for name in ("down.0", "down.1", "down.2", "up.0", "up.1"):
        weights[f"{name}.norm.weight"][:6] = 1.0
        weights[f"{name}.norm.bias"][:4] = 2.0  # hardly anything is below −2 deviations
    weights["down.0.norm.bias"][4:6] = -0.5  # of contrasts, the strong ones
    out, bias = weights["last.weight"], weights["last.bias"]
    for color in range(_RGB):
        out[color, color, 4, 4], out[color, _RGB, 4, 4] = 4.0, -4.0
        out[color, 4:6, 4, 4] = -1.2
    bias[:] = 3.0


class Weights:
    """A network's weights by name, all zero to begin with."""

    def __init__(self, network: nn.Module) -> None:
        self._named = {name: one.data for name, one in network.named_parameters()}
        for value in self._named.values():
            value.zero_()

    def __getitem__(self, name: str) -> Tensor:
        return self._named[name]

    def __call__(self, name: str, change: Callable[[Tensor], None]) -> None:
        """Change the weight of a layer."""
        change(self._named[f"{name}.weight"])


def _centre(weight: Float[Tensor, "o i h w"]) -> None:
    """Hand the first three channels on."""
    for color in range(_RGB):
        weight[color, color, weight.shape[2] // 2, weight.shape[3] // 2] = 1.0


def _all_on(weight: Float[Tensor, "o i 1 1"]) -> None:
    weight[:, : len(weight), 0, 0] = torch.eye(len(weight))


def _blur(weight: Float[Tensor, "o i 3 3"]) -> None:
    for channel in range(min(weight.shape[:2])):
        weight[channel, channel] = BINOMIAL


def _color_and_contrast(weight: Float[Tensor, "o 3 9 9"]) -> None:
    _centre(weight)
    weight[_RGB, :, 4, 4] = _LIGHT
    away = torch.arange(9.0) - 4
    square = away[:, None] ** 2 + away[None] ** 2
    fine, coarse = torch.exp(-square / 2), torch.exp(-square / 8)
    contrast = fine / fine.sum() - coarse / coarse.sum()
    weight[4] = _LIGHT[:, None, None] * contrast
    weight[5] = -weight[4]
