"""Sets weights of image networks by formula, so that they filter images without training.

Most layers are switched off: a residual block whose second convolution is zero returns its input.
The remaining path is described at each step below.
"""

__all__ = ["BINOMIAL_KERNEL", "COLORS", "Weights", "set_denoising_weights", "set_outline_weights"]

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.images.stylise import Stylise

if TYPE_CHECKING:
    from gsgen.reference_plugins.diffusion.unet import UNet

COLORS = 3
_MAX_DETAIL = 1.2  # standard deviations of fine detail; stronger contrasts are edges and stay
_SILU_FACTOR = 3.0  # factor before SiLU, so that it approximates a ReLU
_LUMA_WEIGHTS = torch.tensor([0.3, 0.6, 0.1])
BINOMIAL_KERNEL = torch.tensor([[1.0, 2.0, 1.0], [2.0, 4.0, 2.0], [1.0, 2.0, 1.0]]) / 16


def set_denoising_weights(unet: "UNet") -> None:
    """Make a U-Net of two levels predict fine detail of low contrast as noise.

    The upper level keeps the image, the lower one a blurred copy. The last GroupNorm normalises
    their difference to variance 1, as noise has, and two SiLU clip it at ±1.2.

    ``unet`` has 3 input and output channels, two levels of one layer, and 8 channels in 4 groups at
    the upper level.
    """
    options = unet.options
    shape = (options.inputs, options.outputs, len(options.channels), options.layers)
    if shape != (COLORS, COLORS, 2, 1) or (options.channels[0], options.groups) != (8, 4):
        message = f"has unsupported options for weights by formula: {options}"
        raise ConfigInvalid(message, where="unet")
    weights = Weights(unet)
    weights("conv_in", _set_center_weights)
    weights("down_blocks.0.downsamplers.0.conv", _set_blur_weights)
    weights("down_blocks.1.resnets.0.conv_shortcut", _set_center_weights)
    for name in ("up_blocks.0.resnets.0", "up_blocks.0.resnets.1", "up_blocks.1.resnets.1"):
        weights(f"{name}.conv_shortcut", _set_unit_weights)  # the skip connections are ignored
    weights("up_blocks.0.upsamplers.0.conv", _set_blur_weights)
    blurred = options.channels[1]
    difference = weights["up_blocks.1.resnets.0.conv_shortcut.weight"]
    norm_parameters = weights["conv_norm_out.weight"], weights["conv_norm_out.bias"]
    output_weight = weights["conv_out.weight"]
    for color in range(COLORS):  # a group of two for each colour: both are the difference
        channel_pair = slice(2 * color, 2 * color + 2)
        difference[channel_pair, blurred + color], difference[channel_pair, color] = 1.0, -1.0
        norm_parameters[0][channel_pair], norm_parameters[1][channel_pair] = (
            _SILU_FACTOR,
            _SILU_FACTOR * torch.tensor([_MAX_DETAIL, -_MAX_DETAIL]),
        )
        output_weight[color, channel_pair, 1, 1] = torch.tensor([1.0, -1.0]) / _SILU_FACTOR
    weights["conv_out.bias"][:] = -_MAX_DETAIL


def set_outline_weights(network: Stylise) -> None:
    """Make a stylisation network draw an image as coloured outlines on white paper.

    Channels hold red, green, blue, brightness, and positive and negative local contrast, each
    standardised by the norms; the last layer combines them.
    """
    channels = network.last.in_channels
    if channels < 6:
        message = f"the network's last layer has {channels} channels, expected at least 6"
        raise ConfigInvalid(message, where="channels")
    weights = Weights(network)
    weights("down.0.conv", _color_and_contrast)
    for name in ("down.1", "down.2", "up.0", "up.1"):
        weights(f"{name}.conv", _set_blur_weights)
    for name in ("down.0", "down.1", "down.2", "up.0", "up.1"):
        weights[f"{name}.norm.weight"][:6] = 1.0
        weights[f"{name}.norm.bias"][:4] = 2.0  # few values are below −2 deviations
    weights["down.0.norm.bias"][4:6] = -0.5  # strong contrasts only
    output_weight, bias = weights["last.weight"], weights["last.bias"]
    for color in range(COLORS):
        output_weight[color, color, 4, 4], output_weight[color, COLORS, 4, 4] = 4.0, -4.0
        output_weight[color, 4:6, 4, 4] = -1.2
    bias[:] = 3.0


class Weights:
    """Access to the weights of a network by name; all weights are set to zero first."""

    def __init__(self, network: nn.Module) -> None:
        self._parameters_by_name = {
            name: parameter.data for name, parameter in network.named_parameters()
        }
        for value in self._parameters_by_name.values():
            value.zero_()

    def __getitem__(self, name: str) -> Tensor:
        return self._parameters_by_name[name]

    def __call__(self, name: str, change: Callable[[Tensor], None]) -> None:
        """Apply a change to the weight tensor of a layer."""
        change(self._parameters_by_name[f"{name}.weight"])


def _set_center_weights(weight: Float[Tensor, "o i h w"]) -> None:
    """Set a convolution kernel that copies the first three channels."""
    for color in range(COLORS):
        weight[color, color, weight.shape[2] // 2, weight.shape[3] // 2] = 1.0


def _set_unit_weights(weight: Float[Tensor, "o i 1 1"]) -> None:
    weight[:, : len(weight), 0, 0] = torch.eye(len(weight))


def _set_blur_weights(weight: Float[Tensor, "o i 3 3"]) -> None:
    for channel in range(min(weight.shape[:2])):
        weight[channel, channel] = BINOMIAL_KERNEL


def _color_and_contrast(weight: Float[Tensor, "o 3 9 9"]) -> None:
    _set_center_weights(weight)
    weight[COLORS, :, 4, 4] = _LUMA_WEIGHTS
    distance = torch.arange(9.0) - 4
    squared_distance = distance[:, None] ** 2 + distance[None] ** 2
    fine_kernel, coarse_kernel = torch.exp(-squared_distance / 2), torch.exp(-squared_distance / 8)
    contrast = fine_kernel / fine_kernel.sum() - coarse_kernel / coarse_kernel.sum()
    weight[4] = _LUMA_WEIGHTS[:, None, None] * contrast
    weight[5] = -weight[4]
