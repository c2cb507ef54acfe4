"""A checkpoint of Difix's kind whose weights are set by formula: it takes blotches off a picture.

A skip connection hands the picture on as it is; the autoencoder carries it to a latent of half its
size, of which the U-Net keeps nothing but soft contrasts, with the sign turned: that is what gets
added to the picture. All of it is as in a run of Difix: a base like sd-turbo, and ``model.pkl``
with the U-Net, the skip connections, and a LoRA that switches them on.

Two things make layers that bend pass a number on as it is. SiLU(a) − SiLU(−a) = a. And GroupNorm
divides by what is known beforehand if a group holds x and −x, and K and −K with a large K.
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

from gsgen.reference_plugins.diffusion.autoencoder import Autoencoder
from gsgen.reference_plugins.diffusion.options import AutoencoderOptions, UNetOptions
from gsgen.reference_plugins.diffusion.unet import UNet
from gsgen.reference_plugins.images.diffusers_writer import (
    SCHEDULE,
    config_of,
    write_network,
    write_schedule,
)
from gsgen.reference_plugins.images.handmade_weights import BINOMIAL, Weights

_RGB = 3
_WIDTH = 24
_LARGE = 16.0  # K
# Of −1 to 1: contrasts up to this are an artifact, those of twice as much are none.
_SOFT = 0.3
_STEEP = 16.0  # how sharply SiLU bends, to pass for a ReLU
# Bends of a function of the contrast d, in units of the above, and by how much its slope changes:
# d up to 1, back to 0 at 2, and the same below.
_BENDS = ((2, -1), (1, 2), (-1, -2), (-2, 1))
_RANK = 4
_SHARE = 8 / _RANK  # α/r, with the α that peft sets
_UNET: dict[str, Any] = {
    "_class_name": "UNet2DConditionModel",
    "block_out_channels": [_WIDTH, _WIDTH],
    "down_block_types": ["DownBlock2D", "DownBlock2D"],  # the middle alone sees the prompt
    "up_block_types": ["UpBlock2D", "UpBlock2D"],
    "cross_attention_dim": 16,
    "attention_head_dim": 4,
    "layers_per_block": 1,
    "norm_num_groups": 3,
    "sample_size": 64,
}
_VAE: dict[str, Any] = {
    "_class_name": "AutoencoderKL",
    "block_out_channels": [_WIDTH, _WIDTH],
    "down_block_types": ["DownEncoderBlock2D", "DownEncoderBlock2D"],
    "up_block_types": ["UpDecoderBlock2D", "UpDecoderBlock2D"],
    "layers_per_block": 1,
    "norm_num_groups": 6,
}
_TIMESTEP = 199


def write_difix(folder: Path) -> Path:
    """Write a base in the layout of diffusers and ``model.pkl`` beside it; return ``folder``."""
    coder = Autoencoder(AutoencoderOptions.of(config_of(_VAE)))
    scale = coder.options.scale
    _hand_on(coder)
    write_network(folder / "vae", _VAE, coder)
    torch.manual_seed(0)
    unet = UNet(UNetOptions.of(config_of(_UNET)))
    # As if it were trained on other things.
    write_network(folder / "unet", _UNET, unet)
    _take_off_blotches(unet, scale)
    write_schedule(folder)
    prompt = np.random.default_rng(0).normal(size=(1, 5, _UNET["cross_attention_dim"]))
    np.savez(folder / "prompt_embeds.npz", prompt_embeds=prompt.astype(np.float32))
    changed = {
        "vae_lora_target_modules": ["decoder.skip_conv_1", "decoder.skip_conv_2"],
        "rank_vae": _RANK,
        "state_dict_unet": unet.state_dict(),
        "state_dict_vae": dict(_skips()),
    }
    torch.save(changed, folder / "model.pkl")
    return folder


def _hand_on(coder: Autoencoder) -> None:
    """Make the latent the picture at half its size, and give the latent at twice its own."""
    weights = Weights(coder)
    first, down = weights["encoder.conv_in.weight"], weights[_sampler("encoder", "down")]
    for color in range(_RGB):
        _pair(first, color, color)
        _fix(weights["encoder.conv_in.bias"], color)
    for channel in range(_WIDTH):  # the mean of four pixels; the pad behind is not seen
        down[channel, channel, :2, :2] = 0.25
    _read_out(weights, "encoder")
    for name, count in (("quant_conv", 8), ("post_quant_conv", 4)):
        weights[f"{name}.weight"][:, :, 0, 0] = torch.eye(count)
    up, bias = weights[_sampler("decoder", "up")], weights["decoder.conv_in.bias"]
    for color in range(_RGB):
        _pair(weights["decoder.conv_in.weight"], color, color)
        _fix(bias, color)
        _fix(weights[_sampler("decoder", "up").replace("weight", "bias")], color)
        for channel in range(4 * color, 4 * color + 2):
            up[channel, channel] = BINOMIAL
    _read_out(weights, "decoder")


def _take_off_blotches(unet: UNet, scale: float) -> None:
    """Make x₀ = −f(d) of the latent x, where d is x − the mean of four, and f keeps soft ones.

    Groups of eight hold x, −x, d four times, K and −K of a colour; ε = (x + √ᾱ f(d)) / √(1 − ᾱ).
    """
    weights = Weights(unet)
    first, last, steps = (
        SCHEDULE[name] for name in ("beta_start", "beta_end", "num_train_timesteps")
    )
    noise = torch.linspace(first**0.5, last**0.5, steps, dtype=torch.float64).square()
    kept = float(torch.cumprod(1 - noise, 0)[_TIMESTEP])
    one, many = scale / math.sqrt(1 - kept), scale * math.sqrt(kept / (1 - kept))
    for color in range(_RGB):  # means of four, handed back: neither sees beyond the border
        weights["down_blocks.0.downsamplers.0.conv.weight"][color, color, 1:, 1:] = 0.25
        weights["up_blocks.0.upsamplers.0.conv.weight"][color, color, 1, 1] = 1.0
    for level, index in ((0, 0), (0, 1), (1, 1)):
        name = f"up_blocks.{level}.resnets.{index}.conv_shortcut.weight"
        weights[name][:, :_WIDTH, 0, 0] = torch.eye(_WIDTH)
    name = "up_blocks.1.resnets.0.conv_shortcut"
    joined, fixed = weights[f"{name}.weight"][:, :, 0, 0], weights[f"{name}.bias"]
    gamma, beta = weights["conv_norm_out.weight"], weights["conv_norm_out.bias"]
    for color in range(_RGB):
        weights["conv_in.weight"][color, color, 1, 1] = 1 / scale
        x, fine, coarse = 8 * color, _WIDTH + color, color  # from the side, and from below
        joined[x, fine], joined[x + 1, fine] = 1.0, -1.0
        joined[x + 2 : x + 6, fine], joined[x + 2 : x + 6, coarse] = 1.0, -1.0
        fixed[x + 6], fixed[x + 7] = _LARGE, -_LARGE
        gamma[x : x + 2] = _LARGE / 2  # the deviation of two K among eight
        gamma[x + 2 : x + 6] = _STEEP * _LARGE / 2
        out = weights["conv_out.weight"][color, :, 1, 1]
        out[x], out[x + 1] = one, -one
        for place, (bend, change) in enumerate(_BENDS, x + 2):
            beta[place], out[place] = _STEEP * _SOFT * bend, many * change / _STEEP


def _skips() -> Iterator[tuple[str, Tensor]]:
    """Yield the skip connections: as they begin, nothing, and a LoRA that lets the picture by."""
    for index in (1, 2):
        name = f"decoder.skip_conv_{index}"
        down, up = torch.zeros(_RANK, _WIDTH, 1, 1), torch.zeros(_WIDTH, _RANK, 1, 1)
        for color in range(_RGB):
            down[color, 4 * color] = 1.0
            if index == 2:  # the one of the picture's own size
                up[4 * color, color], up[4 * color + 1, color] = 1 / _SHARE, -1 / _SHARE
        yield f"{name}.base_layer.weight", torch.zeros(_WIDTH, _WIDTH, 1, 1)
        yield f"{name}.lora_A.vae_skip.weight", down
        yield f"{name}.lora_B.vae_skip.weight", up


def _pair(weight: Float[Tensor, "o i 3 3"], color: int, source: int) -> None:
    weight[4 * color, source, 1, 1], weight[4 * color + 1, source, 1, 1] = 1.0, -1.0


def _fix(bias: Float[Tensor, " o"], color: int) -> None:
    bias[4 * color + 2], bias[4 * color + 3] = _LARGE, -_LARGE


def _read_out(weights: Weights, part: str) -> None:
    """Give the colours of groups that hold x, −x, K and −K."""
    for color in range(_RGB):
        pair = slice(4 * color, 4 * color + 2)
        weights[f"{part}.conv_norm_out.weight"][pair] = _LARGE / math.sqrt(2)
        weights[f"{part}.conv_out.weight"][color, pair, 1, 1] = torch.tensor([1.0, -1.0])


def _sampler(part: str, way: str) -> str:
    return f"{part}.{way}_blocks.0.{way}samplers.0.conv.weight"
