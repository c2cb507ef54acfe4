"""Writes synthetic checkpoints of networks that compute Gaussians from pictures."""

__all__ = ["write_lgm", "write_splatter_image"]

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from torch import Tensor, nn

from gsgen.reference_plugins.feed_forward.lgm_checkpoint import CHANNELS
from gsgen.reference_plugins.feed_forward.multi_view_unet import MultiViewUNet, MultiViewUNetOptions
from gsgen.reference_plugins.feed_forward.relief_weights import set_lgm_relief, set_splatter_relief
from gsgen.reference_plugins.feed_forward.song_unet import SongUNet, SongUNetOptions
from gsgen.reference_plugins.feed_forward.splatter_image_checkpoint import rays_of_pixels
from gsgen.reference_plugins.loading.safetensors import write_safetensors

_FIELD_OF_VIEW = 51.98948897809546  # degrees, of the pictures of cars and chairs
_NORM_NAMES = ("norm", "norm0", "norm1", "norm2", "aux_norm", "norm_out")
_HARMONICS_OF_VECTOR = ((0.0, 0.0, -1.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def write_splatter_image(
    folder: Path,
    *,
    side: int = 32,
    width: int = 16,
    blocks: int = 1,
    pictures: int = 1,
    category: str = "cars",
    options: Mapping[str, Any] | None = None,
    relief: bool = False,
    seed: int = 0,
) -> Path:
    """Write an untrained Splatter Image predictor in the authors' layout, and return the folder.

    Args:
        folder: Where ``.hydra/config.yaml`` and ``model_latest.pth`` are written.
        side: Pixels of a side of the pictures.
        width: Channels of the first level; 128 in the published networks.
        blocks: Residual blocks of each level; 4 in the published networks.
        pictures: Number of pictures.
        category: Objects of the training: ``cars`` and ``chairs`` have a fixed lens, ``hydrants``
            and ``teddybears`` measured ones.
        options: Changed options, by dotted names such as ``model.isotropic``.
        relief: Whether the network raises a picture of a ball, by weights set by formula.
        seed: Of the weights.
    """
    config = _splatter_config(side, blocks, pictures, category)
    for name, value in (options or {}).items():
        section, _, key = name.partition(".")
        config[section][key] = value
    has_measured_lens = category in ("hydrants", "teddybears")
    channels = 1 + (3 if config["model"]["network_with_offset"] else 0) + 1 + 3 + 4 + 3
    channels += 9 if config["model"]["max_sh_degree"] else 0
    embedding = 6 * config["cam_embd"]["dimension"] if config["cam_embd"]["embedding"] else 0
    unet = SongUNet(
        SongUNetOptions(
            resolution=config["model"]["base_dim"],
            width=width,
            inputs=3,
            outputs=channels,
            blocks=blocks,
            attention=tuple(config["model"]["attention_resolutions"]),
            embedding=embedding,
            pictures=pictures,
        )
    )
    rng = np.random.default_rng(seed)
    name = "network_with_offset" if config["model"]["network_with_offset"] else "network_wo_offset"
    state = {f"{name}.encoder.{key}": value for key, value in _random_state(unet, rng).items()}
    state |= _resampling_filters(unet, f"{name}.encoder.")
    head = _random_state(nn.Conv2d(channels, channels, 1), rng)
    state |= {f"{name}.out.{key}": value for key, value in head.items()}
    # Scales of a few hundredths, as trained networks have.
    state[f"{name}.out.bias"][5 if config["model"]["network_with_offset"] else 2 :][:3] -= 3
    focal = 1.0 if has_measured_lens else side / (2 * np.tan(np.deg2rad(_FIELD_OF_VIEW) / 2))
    if relief:
        set_splatter_relief(state, name, side, blocks, float(focal))
    state["ray_dirs"] = rays_of_pixels(side, focal)
    if config["model"]["max_sh_degree"]:
        turn = torch.tensor(_HARMONICS_OF_VECTOR)
        state |= {"v_to_sh_transform": turn[None], "sh_to_v_transform": turn.T[None].contiguous()}
    (folder / ".hydra").mkdir(parents=True, exist_ok=True)
    (folder / ".hydra" / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False), "utf-8")
    torch.save({"iteration": 1, "model_state_dict": state}, folder / "model_latest.pth")
    return folder


def write_lgm(
    folder: Path,
    *,
    down: tuple[int, ...] = (32, 32, 64),
    up: tuple[int, ...] = (64, 32),
    attention: int = 1,
    is_pickled: bool = False,
    relief: int = 0,
    seed: int = 0,
) -> Path:
    """Write an untrained LGM network in the authors' layout, and return the folder.

    Args:
        folder: Where ``model.safetensors`` is written.
        down: Channels of each level on the way down, multiples of 32; six levels of 64 to 1024 in
            the published networks.
        up: Channels of each level on the way up.
        attention: Number of lowest levels with attention.
        is_pickled: Whether ``torch.save`` writes ``model.pth`` instead.
        relief: Pixels of a side of the pictures of a ball that the network raises, by weights set
            by formula; 0 for random weights.
        seed: Of the weights.
    """
    unet = MultiViewUNet(
        MultiViewUNetOptions(
            down=down,
            down_attention=tuple(len(down) - level <= attention for level in range(len(down))),
            middle_attention=attention > 0,
            up=up,
            up_attention=tuple(level < attention for level in range(len(up))),
        )
    )
    rng = np.random.default_rng(seed)
    state = {f"unet.{name}": value for name, value in _random_state(unet, rng).items()}
    head = _random_state(nn.Conv2d(CHANNELS, CHANNELS, 1), rng)
    state |= {f"conv.{name}": value for name, value in head.items()}
    state["conv.weight"][:3] *= 0.5  # most positions lie within ±1, where they are clamped
    if relief:
        set_lgm_relief(state, relief, len(up) - 1)
    folder.mkdir(parents=True, exist_ok=True)
    if is_pickled:
        torch.save(state, folder / "model.pth")
    else:
        write_safetensors(folder / "model.safetensors", state)
    return folder


def _splatter_config(side: int, blocks: int, pictures: int, category: str) -> dict[str, Any]:
    has_measured_lens = category in ("hydrants", "teddybears")
    poses = {"embedding": "pose", "encode_embedding": "positional", "dimension": 10}
    no_poses: dict[str, Any] = {"embedding": None, "encode_embedding": None, "dimension": 0}
    return {
        "cam_embd": (poses if pictures > 1 else no_poses) | {"method": "film"},
        "general": {"device": 0, "random_seed": 0},
        "data": {
            "training_resolution": side,
            "fov": _FIELD_OF_VIEW,
            "input_images": pictures,
            "category": category,
            "znear": -2.0 if has_measured_lens else 0.8,
            "zfar": 2.0 if has_measured_lens else 1.8,
            "white_background": not has_measured_lens,
            "origin_distances": has_measured_lens,
        },
        "model": {
            "max_sh_degree": 1,
            "inverted_x": False,
            "inverted_y": True,
            "name": "SingleUNet",
            "opacity_scale": 1.0,
            "opacity_bias": -2.0,
            "scale_bias": 0.02,
            "scale_scale": 0.003,
            "xyz_scale": 0.1,
            "xyz_bias": 0.0,
            "depth_scale": 1.0,
            "depth_bias": 0.0,
            "network_without_offset": False,
            "network_with_offset": True,
            "attention_resolutions": [16],
            "num_blocks": blocks,
            "cross_view_attention": True,
            "base_dim": side,
            "isotropic": False,
        },
    }


def _random_state(network: nn.Module, rng: np.random.Generator) -> dict[str, Tensor]:
    """Return random weights of a network that keep the size of its features."""
    state = {}
    for name, value in network.state_dict().items():
        parent, _, kind = name.rpartition(".")
        shape = tuple(value.shape)
        noise = rng.normal(size=shape)
        if kind == "bias":
            weights = 0.1 * noise
        elif parent.rpartition(".")[2].endswith(_NORM_NAMES):
            weights = 1 + 0.1 * noise
        else:
            weights = noise / np.sqrt(max(1, np.prod(shape[1:])))
        state[name] = torch.from_numpy(weights.astype(np.float32))
    return state


def _resampling_filters(unet: SongUNet, prefix: str) -> dict[str, Tensor]:
    """Return the buffers of the training code's blocks that halve or double the sides."""
    names = [
        name
        for name, _ in unet.named_modules()
        if name.endswith(("_down.conv0", "_up.conv0", "_down.skip", "_up.skip"))
    ]
    return {f"{prefix}{name}.resample_filter": torch.full((1, 1, 2, 2), 0.25) for name in names}
