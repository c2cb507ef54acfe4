"""Reads published style networks; keys and shapes of a file tell which one it is.

The layouts are those of pytorch/examples (``fast_neural_style``), naoto0804/pytorch-AdaIN
(``decoder.pth`` and ``vgg_normalised.pth``) and bryandlee/animegan2-pytorch.
"""

__all__ = ["StyleFiles", "read_style"]

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.safetensors import is_safetensors, read_safetensors
from gsgen.reference_plugins.loading.states import load_state, require_tensors
from gsgen.reference_plugins.styles.adain import AdaIn, decoder_of_width, encoder_of_width
from gsgen.reference_plugins.styles.anime_gan import AnimeGan, AnimeGanOptions
from gsgen.reference_plugins.styles.fast_neural_style import FastNeuralStyle
from gsgen.reference_plugins.styles.style_transfer import StyleTransfer

_DECODER_FILE, _ENCODER_FILE = "decoder.pth", "vgg_normalised.pth"
# Statistics that instance norms of PyTorch 0.3 kept, and that nothing uses.
_DEPRECATED = re.compile(r"(^|\.)in\d+\.(running_(mean|var)|num_batches_tracked)$")
_AFTER_RELU4_1 = re.compile(r"(3[1-9]|[45]\d)\.(weight|bias)$")  # after relu4_1

State = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class StyleFiles:
    """The files of a style network, and how it is built of them.

    Attributes:
        weights: The file of the network, or the folder with the two of AdaIN.
        style: AdaIN's style picture.
        style_side: Pixels of the shorter side that the picture is resized to; 0 leaves it.
        align_corners: Of AnimeGANv2: whether the corners of features stay at those of the image.
        size: Height and width of images; None for any.
        slider: Whether the strength of the style is an input.
    """

    weights: Path
    style: Path | None = None
    style_side: int = 512
    align_corners: bool = True
    size: tuple[int, int] | None = None
    slider: bool = True

    @property
    def paths(self) -> list[Path]:
        """The files that hold the weights."""
        if self.weights.is_dir():
            return [self.weights / _DECODER_FILE, self.weights / _ENCODER_FILE]
        encoder = self.weights.parent / _ENCODER_FILE
        return [self.weights, encoder] if self.style else [self.weights]


def read_style(files: StyleFiles) -> StyleTransfer:
    """Read a published style network, of any of the known layouts.

    Raises:
        CheckpointInvalid: The file is of another layout, or a tensor is missing or does not fit.
        ConfigInvalid: AdaIN lacks a style picture, or another network got one.
    """
    file = files.paths[0]
    state = _read_state(file)
    for key, read in _LAYOUTS.items():
        if key in state:
            if files.style is not None and read is not _read_adain:
                message = "belongs to AdaIN, but the network was trained for one style"
                raise ConfigInvalid(message, where="--style")
            return read(files, state)
    message = "is not a style network of a known layout"
    hint = (
        "Known are fast neural style (pytorch/examples), AnimeGANv2 (bryandlee), AdaIN "
        f"(naoto0804: a folder with {_DECODER_FILE} and {_ENCODER_FILE}), and a folder with "
        "config.json and stylise.safetensors."
    )
    raise CheckpointInvalid(message, where=str(file), hint=hint)


def _read_state(file: Path) -> dict[str, Any]:
    required_file(file, "the weights of the network")
    state = read_safetensors(file) if is_safetensors(file) else load_state(file, "the weights")
    return {name: value for name, value in state.items() if not _DEPRECATED.search(name)}


def _load(network: nn.Module, file: Path, state: State) -> None:
    expected = {
        name: tuple(value.shape)
        for name, value in network.state_dict().items()
        if not name.startswith("style_")
    }
    network.load_state_dict(require_tensors(file, state, expected), strict=True)


def _width(file: Path, state: State, name: str) -> int:
    """Return the number of channels of a convolution, in multiples of a network's width."""
    value = state[name]
    if not isinstance(value, Tensor) or value.ndim != 4:
        raise CheckpointInvalid(f"{name} is not the weight of a convolution", where=str(file))
    return value.shape[0]


def _read_fast_neural_style(files: StyleFiles, state: State) -> StyleTransfer:
    file = files.paths[0]
    blocks = len({match[1] for name in state if (match := re.match(r"res(\d+)\.", name))})
    width = _width(file, state, "conv1.conv2d.weight")
    network = FastNeuralStyle(width, blocks, files.size, slider=files.slider)
    _load(network, file, state)
    return network


def _read_anime_gan(files: StyleFiles, state: State) -> StyleTransfer:
    file = files.paths[0]
    blocks = len(
        {match[1] for name in state if (match := re.match(r"block_c\.(\d+)\.layers\.", name))}
    )
    options = AnimeGanOptions(
        width=_width(file, state, "block_a.0.1.weight"),
        blocks=blocks,
        align_corners=files.align_corners,
    )
    network = AnimeGan(options, files.size, slider=files.slider)
    _load(network, file, state)
    return network


def _read_adain(files: StyleFiles, state: State) -> StyleTransfer:
    if files.style is None:
        raise ConfigInvalid("AdaIN needs a picture of the style", where="--style")
    decoder_file, encoder_file = files.paths
    # The decoder's last layer but one has the width of the encoder's first.
    width = _width(decoder_file, state, "25.weight")
    decoder, encoder = decoder_of_width(width), encoder_of_width(width)
    _load(decoder, decoder_file, state)
    published = _read_state(encoder_file)
    used = {name: value for name, value in published.items() if not _AFTER_RELU4_1.match(name)}
    _load(encoder, encoder_file, used)
    picture = _style_picture(files.style, files.style_side)
    return AdaIn(encoder, decoder, picture, files.size, slider=files.slider)


def _style_picture(file: Path, side: int) -> Float[Tensor, "1 3 h w"]:
    """Return a picture in 0 … 1, its shorter side resized to ``side`` pixels."""
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError as error:
        hint = "pip install 'gsgen[formats]'"
        raise ConfigInvalid(
            "pictures need pillow, which is not installed", where="--style", hint=hint
        ) from error
    required_file(file, "the picture of the style")
    try:
        with Image.open(file) as opened:
            picture = opened.convert("RGB")
    except (UnidentifiedImageError, OSError) as error:
        raise ConfigInvalid(f"cannot be read: {error}", where=str(file)) from error
    width, height = picture.size
    if side and side != min(width, height):
        # As torchvision resizes: the longer side is rounded down.
        longer = int(side * max(width, height) / min(width, height))
        size = (side, longer) if width <= height else (longer, side)
        picture = picture.resize(size, Image.Resampling.BILINEAR)
    array = np.asarray(picture, np.float32) / 255
    return torch.from_numpy(array).permute(2, 0, 1)[None].contiguous()


# A tensor that only files of the layout have → its reader.
_LAYOUTS: Mapping[str, Callable[[StyleFiles, State], StyleTransfer]] = {
    "conv1.conv2d.weight": _read_fast_neural_style,
    "block_a.0.1.weight": _read_anime_gan,
    "28.weight": _read_adain,
}
