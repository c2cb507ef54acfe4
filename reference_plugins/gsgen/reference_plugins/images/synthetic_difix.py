"""Writes a synthetic checkpoint of Difix that removes blotches, with weights set by formula.

A skip connection copies the image. The autoencoder encodes it to a latent of half its size, of
which the U-Net keeps only soft contrasts, negated: their decoded image is added to the copy. The
files are as in a run of Difix: a base like sd-turbo, and ``model.pkl`` with the U-Net, the skip
connections, and a LoRA that switches them on.

Two identities pass a number through nonlinear layers unchanged. SiLU(a) − SiLU(−a) = a. And
GroupNorm divides by a known number if a group holds x and −x, and K and −K with a large K.
"""

__all__ = ["write_difix"]

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.diffusion.autoencoder import Autoencoder, autoencoder_of
from gsgen.reference_plugins.diffusion.unet import UNet, unet_of
from gsgen.reference_plugins.images.diffusers_writer import (
    SCHEDULE,
    config_of,
    write_network,
    write_schedule,
)
from gsgen.reference_plugins.images.handmade_weights import BINOMIAL_KERNEL, COLORS, Weights

_CHANNEL_COUNT = 24
_ACTIVATION_SCALE = 16.0  # K
# Contrasts in −1 … 1 up to this are artifacts; those of twice as much are edges.
_BLUR_STRENGTH = 0.3
_SILU_FACTOR = 16.0  # factor before SiLU, so that it approximates a ReLU
# Knots of f(d), in units of _SOFT, and the change of its slope there: f(d) = d up to 1, back to 0
# at 2, and odd.
_BEND_CHANNEL_SIGNS = ((2, -1), (1, 2), (-1, -2), (-2, 1))
_LORA_RANK = 4
_ALPHA_SHARE = 8 / _LORA_RANK  # α/r, with the α that peft sets
_UNET_CONFIG: dict[str, Any] = {
    "_class_name": "UNet2DConditionModel",
    "block_out_channels": [_CHANNEL_COUNT, _CHANNEL_COUNT],
    # Only the middle block attends to the prompt.
    "down_block_types": ["DownBlock2D", "DownBlock2D"],
    "up_block_types": ["UpBlock2D", "UpBlock2D"],
    "cross_attention_dim": 16,
    "attention_head_dim": 4,
    "layers_per_block": 1,
    "norm_num_groups": 3,
    "sample_size": 64,
}
_VAE_CONFIG: dict[str, Any] = {
    "_class_name": "AutoencoderKL",
    "block_out_channels": [_CHANNEL_COUNT, _CHANNEL_COUNT],
    "down_block_types": ["DownEncoderBlock2D", "DownEncoderBlock2D"],
    "up_block_types": ["UpDecoderBlock2D", "UpDecoderBlock2D"],
    "layers_per_block": 1,
    "norm_num_groups": 6,
}
_TIMESTEP = 199


def write_difix(folder: Path) -> Path:
    """Write a synthetic Difix checkpoint, a diffusers base and a ``model.pkl``, to the folder."""
    autoencoder_model = autoencoder_of(config_of(_VAE_CONFIG))
    scale = autoencoder_model.options.scale
    _set_identity(autoencoder_model)
    write_network(folder / "vae", _VAE_CONFIG, autoencoder_model)
    torch.manual_seed(0)
    unet = unet_of(config_of(_UNET_CONFIG))
    # The base has random weights, as if trained for another task.
    write_network(folder / "unet", _UNET_CONFIG, unet)
    _set_blotch_removal(unet, scale)
    write_schedule(folder)
    prompt = np.random.default_rng(0).normal(size=(1, 5, _UNET_CONFIG["cross_attention_dim"]))
    np.savez(folder / "prompt_embeds.npz", prompt_embeds=prompt.astype(np.float32))
    changed_weights = {
        "vae_lora_target_modules": ["decoder.skip_conv_1", "decoder.skip_conv_2"],
        "rank_vae": _LORA_RANK,
        "state_dict_unet": unet.state_dict(),
        "state_dict_vae": dict(_skip_layers()),
    }
    torch.save(changed_weights, folder / "model.pkl")
    return folder


def _set_identity(autoencoder_model: Autoencoder) -> None:
    """Set the weights so that the encoder halves the image size and the decoder doubles it."""
    weights = Weights(autoencoder_model)
    first, downsampler_weight = (
        weights["encoder.conv_in.weight"],
        weights[_sampler("encoder", "down")],
    )
    for color in range(COLORS):
        _set_difference(first, color, color)
        _set_bias(weights["encoder.conv_in.bias"], color)
    for channel in range(_CHANNEL_COUNT):  # the mean of four pixels; the padding is not used
        downsampler_weight[channel, channel, :2, :2] = 0.25
    _set_output(weights, "encoder")
    for name, count in (("quant_conv", 8), ("post_quant_conv", 4)):
        weights[f"{name}.weight"][:, :, 0, 0] = torch.eye(count)
    upsampler_weight, bias = weights[_sampler("decoder", "up")], weights["decoder.conv_in.bias"]
    for color in range(COLORS):
        _set_difference(weights["decoder.conv_in.weight"], color, color)
        _set_bias(bias, color)
        _set_bias(weights[_sampler("decoder", "up").replace("weight", "bias")], color)
        for channel in range(4 * color, 4 * color + 2):
            upsampler_weight[channel, channel] = BINOMIAL_KERNEL
    _set_output(weights, "decoder")


def _set_blotch_removal(unet: UNet, scale: float) -> None:
    """Set the U-Net to predict the clean latent x₀ = −f(d), for a nonlinear f of fine detail d.

    d is the latent x minus the mean of four pixels. Groups of eight hold x, −x, four times d, K and
    −K of a colour; ε = (x + √ᾱ f(d)) / √(1 − ᾱ).
    """
    weights = Weights(unet)
    first, last, steps = (
        SCHEDULE[name] for name in ("beta_start", "beta_end", "num_train_timesteps")
    )
    noise = torch.linspace(first**0.5, last**0.5, steps, dtype=torch.float64).square()
    signal = float(torch.cumprod(1 - noise, 0)[_TIMESTEP])
    image_gain = scale / math.sqrt(1 - signal)
    contrast_gain = scale * math.sqrt(signal / (1 - signal))
    for color in range(COLORS):  # means of four pixels; neither convolution reads beyond the border
        weights["down_blocks.0.downsamplers.0.conv.weight"][color, color, 1:, 1:] = 0.25
        weights["up_blocks.0.upsamplers.0.conv.weight"][color, color, 1, 1] = 1.0
    for level, index in ((0, 0), (0, 1), (1, 1)):
        name = f"up_blocks.{level}.resnets.{index}.conv_shortcut.weight"
        weights[name][:, :_CHANNEL_COUNT, 0, 0] = torch.eye(_CHANNEL_COUNT)
    name = "up_blocks.1.resnets.0.conv_shortcut"
    joined_weight, layer_bias = weights[f"{name}.weight"][:, :, 0, 0], weights[f"{name}.bias"]
    gamma, beta = weights["conv_norm_out.weight"], weights["conv_norm_out.bias"]
    for color in range(COLORS):
        weights["conv_in.weight"][color, color, 1, 1] = 1 / scale
        # Channels of the skip connection, and of the lower level.
        x, fine_channel, coarse_channel = 8 * color, _CHANNEL_COUNT + color, color
        joined_weight[x, fine_channel], joined_weight[x + 1, fine_channel] = 1.0, -1.0
        joined_weight[x + 2 : x + 6, fine_channel], joined_weight[x + 2 : x + 6, coarse_channel] = (
            1.0,
            -1.0,
        )
        layer_bias[x + 6], layer_bias[x + 7] = _ACTIVATION_SCALE, -_ACTIVATION_SCALE
        gamma[x : x + 2] = (
            _ACTIVATION_SCALE / 2
        )  # the standard deviation of K and −K in a group of eight
        gamma[x + 2 : x + 6] = _SILU_FACTOR * _ACTIVATION_SCALE / 2
        output_weight = weights["conv_out.weight"][color, :, 1, 1]
        output_weight[x], output_weight[x + 1] = image_gain, -image_gain
        for channel, (paired_channel, change) in enumerate(_BEND_CHANNEL_SIGNS, x + 2):
            beta[channel], output_weight[channel] = (
                _SILU_FACTOR * _BLUR_STRENGTH * paired_channel,
                contrast_gain * change / _SILU_FACTOR,
            )


def _skip_layers() -> Iterator[tuple[str, Tensor]]:
    """Yield weights of Difix's skip connections: zeros, and a LoRA that adds the image."""
    for index in (1, 2):
        name = f"decoder.skip_conv_{index}"
        downsampler_weight, upsampler_weight = (
            torch.zeros(_LORA_RANK, _CHANNEL_COUNT, 1, 1),
            torch.zeros(_CHANNEL_COUNT, _LORA_RANK, 1, 1),
        )
        for color in range(COLORS):
            downsampler_weight[color, 4 * color] = 1.0
            if index == 2:  # the connection of the image's full resolution
                upsampler_weight[4 * color, color], upsampler_weight[4 * color + 1, color] = (
                    1 / _ALPHA_SHARE,
                    -1 / _ALPHA_SHARE,
                )
        yield f"{name}.base_layer.weight", torch.zeros(_CHANNEL_COUNT, _CHANNEL_COUNT, 1, 1)
        yield f"{name}.lora_A.vae_skip.weight", downsampler_weight
        yield f"{name}.lora_B.vae_skip.weight", upsampler_weight


def _set_difference(weight: Float[Tensor, "o i 3 3"], color: int, source: int) -> None:
    weight[4 * color, source, 1, 1], weight[4 * color + 1, source, 1, 1] = 1.0, -1.0


def _set_bias(bias: Float[Tensor, " o"], color: int) -> None:
    bias[4 * color + 2], bias[4 * color + 3] = _ACTIVATION_SCALE, -_ACTIVATION_SCALE


def _set_output(weights: Weights, part: str) -> None:
    """Set the output layer to recover each colour x from the SiLU of two channels, x and −x."""
    for color in range(COLORS):
        channel_pair = slice(4 * color, 4 * color + 2)
        weights[f"{part}.conv_norm_out.weight"][channel_pair] = _ACTIVATION_SCALE / math.sqrt(2)
        weights[f"{part}.conv_out.weight"][color, channel_pair, 1, 1] = torch.tensor([1.0, -1.0])


def _sampler(part: str, direction: str) -> str:
    return f"{part}.{direction}_blocks.0.{direction}samplers.0.conv.weight"
