"""Writes synthetic checkpoints of image networks, in the layouts of their training code."""

__all__ = ["write_denoiser", "write_stylise"]

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gsgen.reference_plugins.images.diffusers_writer import config_of, write_network, write_schedule
from gsgen.reference_plugins.images.handmade_weights import (
    set_denoising_weights,
    set_outline_weights,
)
from gsgen.reference_plugins.images.stylise import Stylise, StyliseOptions
from gsgen.reference_plugins.writing.random_layers import add_noise

_UNET_CONFIG: Mapping[str, Any] = {
    "_class_name": "UNet2DModel",
    "block_out_channels": [8, 16],
    "down_block_types": ["DownBlock2D", "AttnDownBlock2D"],
    "up_block_types": ["AttnUpBlock2D", "UpBlock2D"],
    "layers_per_block": 1,
    "norm_num_groups": 4,
    "sample_size": 16,
}
_VAE_CONFIG: Mapping[str, Any] = {
    "_class_name": "AutoencoderKL",
    "block_out_channels": [4, 8],
    "down_block_types": ["DownEncoderBlock2D", "DownEncoderBlock2D"],
    "up_block_types": ["UpDecoderBlock2D", "UpDecoderBlock2D"],
    "layers_per_block": 1,
    "norm_num_groups": 2,
}


def write_denoiser(
    folder: Path,
    unet: Mapping[str, Any] | None = None,
    *,
    latent: bool = False,
    schedule: Mapping[str, Any] | None = None,
    smoothing: bool = False,
    seed: int = 0,
) -> Path:
    """Write a synthetic diffusion checkpoint in the layout of diffusers, and return the folder.

    ``unet`` and ``schedule`` are changed options. With ``latent``, the U-Net works on latents of 4
    channels; with ``smoothing``, it removes fine noise, by weights set by formula.
    """
    from gsgen.reference_plugins.diffusion.autoencoder import autoencoder_of
    from gsgen.reference_plugins.diffusion.unet import unet_of

    torch.manual_seed(seed)
    channels = {"in_channels": 4, "out_channels": 4} if latent else {}
    config = {**_UNET_CONFIG, **channels, **(unet or {})}
    network = unet_of(config_of(config))
    add_noise(network)
    if smoothing:
        set_denoising_weights(network)
    write_network(folder / "unet", config, network)
    if latent:
        autoencoder_model = autoencoder_of(config_of(_VAE_CONFIG))
        add_noise(autoencoder_model)
        write_network(folder / "vae", _VAE_CONFIG, autoencoder_model)
    write_schedule(folder, schedule)
    if config["_class_name"] == "UNet2DConditionModel":
        rows = np.random.default_rng(seed).normal(size=(1, 5, config["cross_attention_dim"]))
        np.savez(folder / "prompt_embeds.npz", encoder_hidden_states=rows.astype(np.float32))
    return folder


def write_stylise(
    folder: Path, *, channels: int = 8, blocks: int = 2, drawing: bool = False, seed: int = 0
) -> Path:
    """Write an untrained style transfer network, and return the folder.

    With ``drawing``, the network draws outlines on paper, by weights set by formula.
    """
    torch.manual_seed(seed)
    network = Stylise(StyliseOptions(channels, blocks), (16, 16))
    add_noise(network)
    if drawing:
        set_outline_weights(network)
    write_network(folder, {"channels": channels, "blocks": blocks}, network, "stylise.safetensors")
    return folder
