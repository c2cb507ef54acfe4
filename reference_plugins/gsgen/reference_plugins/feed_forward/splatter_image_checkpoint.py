"""Reads checkpoints of Splatter Image: hydra's options, and the weights of the predictor.

The layout is that of szymanowiczs/splatter-image, ``train_network.py`` and ``eval.py``:
``DIR/.hydra/config.yaml`` and ``DIR/model_latest.pth`` with ``model_state_dict``.
"""

__all__ = ["SplatterImageCheckpoint", "SplatterImageOptions", "read_splatter_image"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.feed_forward.song_unet import SongUNet, SongUNetOptions
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.states import entries_below, load_state, require_tensors
from gsgen.reference_plugins.loading.yaml_options import YamlOptions, read_yaml_options

_CONFIG_FILES = (".hydra/config.yaml", "config.yaml")
_WEIGHT_FILES = ("model_latest.pth", "model_best.pth", "model.pth")
_FIXED_LENS = ("cars", "chairs")
_MEASURED_LENS = ("hydrants", "teddybears")
_NETWORKS = {True: "network_with_offset", False: "network_wo_offset"}
_POSE_NUMBERS = 6  # centre and viewing axis of a camera


@dataclass(frozen=True, slots=True, kw_only=True)
class SplatterImageOptions:
    """The options of training that the predictor depends on.

    Attributes:
        resolution: Pixels of a side of a picture.
        pictures: Number of pictures of an object.
        depth_range: Smallest and largest depth, in units.
        degree: Degree of the spherical harmonics: 0 or 1.
        has_offset: Whether the network moves Gaussians off their rays.
        is_isotropic: Whether all axes of a Gaussian have the first one's scale.
        has_measured_lens: Whether the focal lengths of the pictures are inputs.
        adds_distance: Whether the distance of the camera from the origin is added to depths.
        pose_frequencies: Numbers that encode each number of a camera's pose; 0 without poses.
        is_on_white: Whether pictures have a white background.
    """

    resolution: int
    pictures: int
    depth_range: tuple[float, float]
    degree: int
    has_offset: bool
    is_isotropic: bool
    has_measured_lens: bool
    adds_distance: bool
    pose_frequencies: int
    is_on_white: bool

    @property
    def channels(self) -> tuple[int, ...]:
        """Channels of the network's output: depth, offset, opacity, scale, rotation, colours."""
        offset = (3,) if self.has_offset else ()
        rest = (9,) if self.degree else ()
        return (1, *offset, 1, 3, 4, 3, *rest)


@dataclass(frozen=True, slots=True, kw_only=True)
class SplatterImageCheckpoint:
    """The network of a Splatter Image checkpoint, its last layer, and the rays of its pixels."""

    folder: Path
    weights: Path
    options: SplatterImageOptions
    unet: SongUNet
    head: tuple[Float[Tensor, "o o 1 1"], Float[Tensor, " o"]]  # the last 1×1 convolution
    rays: Float[Tensor, "1 3 h w"]  # of each pixel, at depth 1; in pixels for measured lenses

    def describe(self) -> str:
        """Return the sizes of the pictures and of the network as one line."""
        options, unet = self.options, self.unet.options
        count = sum(weight.numel() for weight in self.unet.parameters())
        pictures = "1 picture" if options.pictures == 1 else f"{options.pictures} pictures"
        return (
            f"{self.weights}: {pictures} of {options.resolution}×{options.resolution}, "
            f"{options.pictures * options.resolution**2:,} Gaussians of SH degree {options.degree}, "
            f"U-Net of width {unet.width} with {count:,} weights"
        )


def read_splatter_image(folder: Path) -> SplatterImageCheckpoint:
    """Read a Splatter Image checkpoint; sizes of the network follow from its tensors."""
    config = read_yaml_options(folder, _CONFIG_FILES, "the options of training")
    weights = next((folder / name for name in _WEIGHT_FILES if (folder / name).is_file()), None)
    path = weights or folder / _WEIGHT_FILES[0]
    state = load_state(path, "the weights of the predictor")
    state = state.get("model_state_dict", state)
    options = _options_of(config)
    name = _NETWORKS[options.has_offset]
    network = entries_below(state, f"{name}.")
    if not network:
        message = f"has no tensors of {name}, as {config.path} says"
        raise CheckpointInvalid(message, where=str(path))
    unet = SongUNet(_unet_options(config, options, network, path))
    encoder = {
        key: value
        for key, value in entries_below(network, "encoder.").items()
        if not key.endswith("resample_filter")  # always a mean of 2 × 2 pixels
    }
    expected = {key: tuple(value.shape) for key, value in unet.state_dict().items()}
    unet.load_state_dict(require_tensors(path, encoder, expected), strict=True)
    outputs = sum(options.channels)
    shapes = {"out.weight": (outputs, outputs, 1, 1), "out.bias": (outputs,)}
    head = require_tensors(path, network, shapes, ignored=("encoder.",))
    side = options.resolution
    rays = require_tensors(
        path,
        state,
        {"ray_dirs": (1, 3, side, side)},
        ignored=(f"{name}.", "sh_to_v_transform", "v_to_sh_transform"),
    )
    return SplatterImageCheckpoint(
        folder=folder,
        weights=path,
        options=options,
        unet=unet.eval(),
        head=(head["out.weight"], head["out.bias"]),
        rays=rays["ray_dirs"],
    )


def _options_of(config: YamlOptions) -> SplatterImageOptions:
    category = config.text("data.category")
    if category not in (*_FIXED_LENS, *_MEASURED_LENS):
        known = ", ".join((*_FIXED_LENS, *_MEASURED_LENS))
        raise config.fault("data.category", category, f"one of {known}")
    if config.text("model.name", "SingleUNet") != "SingleUNet":
        raise config.fault("model.name", config.text("model.name"), "SingleUNet")
    degree = config.integer("model.max_sh_degree", 1)
    if degree not in (0, 1):
        raise config.fault("model.max_sh_degree", degree, "0 or 1")
    pictures = config.integer("data.input_images", 1)
    if pictures > 1 and not config.flag("model.cross_view_attention", default=True):
        raise config.fault("model.cross_view_attention", False, "true for several pictures")
    return SplatterImageOptions(
        resolution=config.integer("data.training_resolution", 128),
        pictures=pictures,
        depth_range=(config.number("data.znear"), config.number("data.zfar")),
        degree=degree,
        has_offset=config.flag("model.network_with_offset", default=True),
        is_isotropic=config.flag("model.isotropic", default=False),
        has_measured_lens=category in _MEASURED_LENS,
        adds_distance=config.flag("data.origin_distances", default=False),
        pose_frequencies=_pose_frequencies(config),
        is_on_white=config.flag("data.white_background", default=False),
    )


def _pose_frequencies(config: YamlOptions) -> int:
    embedding = config.text("cam_embd.embedding", "")
    if not embedding:
        return 0
    if embedding != "pose":
        raise config.fault("cam_embd.embedding", embedding, "pose, or none")
    encoding = config.text("cam_embd.encode_embedding", "")
    if encoding != "positional":
        raise config.fault("cam_embd.encode_embedding", encoding or None, "positional")
    dimension = config.integer("cam_embd.dimension", 10)
    if dimension < 2 or dimension % 2:
        raise config.fault("cam_embd.dimension", dimension, "an even number")
    return dimension


def _unet_options(
    config: YamlOptions, options: SplatterImageOptions, network: Mapping[str, Any], path: Path
) -> SongUNetOptions:
    side = config.integer("model.base_dim", 128)
    first = network.get(f"encoder.enc.{side}x{side}_conv.weight")
    if not isinstance(first, Tensor) or first.ndim != 4:
        message = f"has no first convolution for model.base_dim {side}"
        raise CheckpointInvalid(message, where=str(path))
    return SongUNetOptions(
        resolution=side,
        width=first.shape[0],
        inputs=3,
        outputs=sum(options.channels),
        blocks=config.integer("model.num_blocks", 4),
        attention=config.integers("model.attention_resolutions", (16,)),
        embedding=_POSE_NUMBERS * options.pose_frequencies,
        pictures=options.pictures,
    )


def rays_of_pixels(resolution: int, focal: float) -> Float[Tensor, "1 3 h w"]:
    """Return the rays of a picture's pixels as the training code stores them, y pointing down."""
    middle = resolution / 2
    steps = (torch.arange(resolution, dtype=torch.float32) + 0.5 - middle) / focal
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    return torch.stack([x, y, torch.ones_like(x)])[None]
