"""Writes untrained style networks, in the layouts of their training code."""

__all__ = ["write_adain", "write_anime_gan", "write_fast_neural_style"]

from pathlib import Path

import torch
from torch import Tensor, nn

from gsgen.reference_plugins.styles.adain import decoder_of_width, encoder_of_width
from gsgen.reference_plugins.styles.anime_gan import AnimeGan, AnimeGanOptions
from gsgen.reference_plugins.styles.fast_neural_style import FastNeuralStyle
from gsgen.reference_plugins.writing.random_layers import add_noise


def write_fast_neural_style(
    file: Path, *, width: int = 8, blocks: int = 5, is_deprecated: bool = False, seed: int = 0
) -> Path:
    """Write a network of pytorch/examples, and return the file.

    With ``is_deprecated``, it has the statistics of norms that old versions of PyTorch kept.
    """
    torch.manual_seed(seed)
    network = FastNeuralStyle(width, blocks, None)
    add_noise(network)
    with torch.no_grad():  # colours are 0 … 255
        network.deconv3.conv2d.weight.mul_(30.0)
        network.deconv3.conv2d.bias.add_(128.0)  # type: ignore[union-attr]
    state = dict(network.state_dict())
    if is_deprecated:
        norms = [
            name.removesuffix(".weight")
            for name in state
            if name.endswith(("in1.weight", "in5.weight"))
        ]
        for name in norms:
            state |= {f"{name}.running_{kind}": torch.zeros(1) for kind in ("mean", "var")}
    return _save(file, state)


def write_anime_gan(file: Path, *, width: int = 4, blocks: int = 4, seed: int = 0) -> Path:
    """Write a generator of AnimeGANv2, and return the file."""
    torch.manual_seed(seed)
    network = AnimeGan(AnimeGanOptions(width=width, blocks=blocks), None)
    add_noise(network)
    return _save(file, dict(network.state_dict()))


def write_adain(folder: Path, *, width: int = 4, seed: int = 0) -> Path:
    """Write AdaIN's decoder and encoder, which is longer than AdaIN needs, and return the folder."""
    torch.manual_seed(seed)
    decoder, encoder = decoder_of_width(width), encoder_of_width(width)
    with torch.no_grad():  # activations keep their size from layer to layer
        for layer in (*encoder, *decoder):
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight)
        last = decoder[28]
        assert isinstance(last, nn.Conv2d)
        assert last.bias is not None
        last.bias.fill_(0.5)
        last.weight.mul_(4.0)
    unused = nn.Conv2d(8 * width, 8 * width, 3)
    unused_state = {f"32.{name}": value for name, value in unused.state_dict().items()}
    _save(folder / "decoder.pth", dict(decoder.state_dict()))
    _save(folder / "vgg_normalised.pth", {**encoder.state_dict(), **unused_state})
    return folder


def _save(file: Path, state: dict[str, Tensor]) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    torch.save(state, file)
    return file
