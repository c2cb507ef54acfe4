"""Writes untrained networks that restore or enlarge images, in the layouts of their own code."""

__all__ = ["write_enhancer"]

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float64
from torch import nn

from gsgen.reference_plugins.enhancers.compact_net import CompactNet, CompactOptions
from gsgen.reference_plugins.enhancers.enhancer import ImageNetwork
from gsgen.reference_plugins.enhancers.naf_net import NAFNet, NAFNetOptions
from gsgen.reference_plugins.enhancers.rrdb_net import RRDBNet, RRDBOptions
from gsgen.reference_plugins.enhancers.swin_ir import SwinIR, SwinIROptions
from gsgen.reference_plugins.writing.random_layers import add_noise

Method = Literal["rrdb", "compact", "swinir", "nafnet"]

_COLORS = 3
_DEVIATION = 0.12  # of what an untrained network adds
_SHIFTS = (-1, 1)
_SHARPNESS = -0.5  # Catmull and Rom's cubic, as Keys 1981 writes it


def write_enhancer(
    file: Path,
    method: Method = "compact",
    *,
    wrapper: str = "params_ema",
    cubic: bool = False,
    seed: int = 0,
    **options: Any,
) -> Path:
    """Write a network, and return the file.

    Args:
        file: The file; its folder is made.
        method: Which network.
        wrapper: The key that the state dict is below; empty for none.
        cubic: Whether the weights of a ``compact`` network are those of Catmull and Rom's cubic
            interpolation, rather than noise.
        seed: Of the noise.
        options: Sizes that differ from small ones.
    """
    torch.manual_seed(seed)
    network = _NETWORKS[method](options)
    add_noise(network)
    _fit_last_layer(network, _LAST_LAYERS[method])
    if cubic:
        assert isinstance(network, CompactNet)
        _set_cubic_weights(network)
    state = dict(network.state_dict())
    file.parent.mkdir(parents=True, exist_ok=True)
    torch.save({wrapper: state} if wrapper else state, file)
    return file


def _rrdb(options: Mapping[str, Any]) -> ImageNetwork:
    sizes: dict[str, Any] = {"scale": 4, "width": 8, "growth": 4, "blocks": 2}
    return RRDBNet(RRDBOptions(**{**sizes, **options}))


def _compact(options: Mapping[str, Any]) -> ImageNetwork:
    sizes: dict[str, Any] = {"scale": 4, "width": 12, "layers": 2}
    return CompactNet(CompactOptions(**{**sizes, **options}))


def _nafnet(options: Mapping[str, Any]) -> ImageNetwork:
    sizes: dict[str, Any] = {"width": 8, "encoder": (1, 2), "middle": 1, "decoder": (1, 1)}
    return NAFNet(NAFNetOptions(**{**sizes, **options}))


def _swinir(options: Mapping[str, Any]) -> ImageNetwork:
    sizes: dict[str, Any] = {
        "scale": 2,
        "width": 12,
        "depths": (2, 2),
        "heads": 3,
        "window": 8,
        "hidden": 24,
        "upsampler": "shuffle",
        "width_after": 64,
        "three_convolutions": False,
        "has_bias": True,
        "has_first_norm": True,
    }
    return SwinIR(SwinIROptions(**{**sizes, **options}))


_NETWORKS: Mapping[Method, Callable[[Mapping[str, Any]], ImageNetwork]] = {
    "rrdb": _rrdb,
    "compact": _compact,
    "swinir": _swinir,
    "nafnet": _nafnet,
}


# Method → the names that its last convolution may have.
_LAST_LAYERS: Mapping[Method, tuple[str, ...]] = {
    "rrdb": ("conv_last",),
    "compact": ("body",),
    "swinir": ("conv_last", "upsample"),
    "nafnet": ("ending",),
}


@torch.no_grad()
def _fit_last_layer(network: ImageNetwork, names: Sequence[str]) -> None:
    """Scale the last layer so that results are about 0.5, and few of them beyond 0 … 1."""
    layers = dict(network.named_modules())
    parent = next(layers[name] for name in names if name in layers)
    layer = [child for child in parent.modules() if isinstance(child, nn.Conv2d)][-1]
    assert layer.bias is not None
    image = torch.rand(1, _COLORS, *[8 * network.multiple] * 2)
    result, weight, bias = network(image), layer.weight.clone(), layer.bias.clone()
    layer.weight.zero_()
    layer.bias.zero_()
    without = network(image)
    layer.bias.fill_(1.0)
    unit = float((network(image) - without).mean())
    factor = float(_DEVIATION / (result - without).std())
    shift = (0.5 - float((without + factor * (result - without)).mean())) / unit
    layer.weight.copy_(factor * weight)
    layer.bias.copy_(factor * bias + shift)


def _set_cubic_weights(network: CompactNet) -> None:
    """Set weights of two convolutions so that the network enlarges by cubic interpolation.

    The first one copies each colour four times, from a row above or below and a column to the left
    or right, and all slopes are 1. So the last one sees five by five pixels, of which each enlarged
    pixel is a sum; that of the repeated pixels, which the network adds, is taken off.
    """
    for parameter in network.parameters():
        parameter.data.zero_()
    first, rectifier, last = network.body
    assert isinstance(first, nn.Conv2d)
    assert isinstance(last, nn.Conv2d)
    assert isinstance(rectifier, nn.PReLU)
    rectifier.weight.data.fill_(1.0)
    scale = network.scale
    for color in range(_COLORS):
        for place, (row, column) in enumerate((r, c) for r in _SHIFTS for c in _SHIFTS):
            feature = 4 * color + place
            first.weight.data[feature, color, 1 + row, 1 + column] = 1.0
            for v in range(scale):
                for u in range(scale):
                    vertical = _half(_cubic_taps(v, scale), row)
                    horizontal = _half(_cubic_taps(u, scale), column)
                    taps = torch.from_numpy(np.outer(vertical, horizontal))
                    last.weight.data[color * scale**2 + v * scale + u, feature] = taps
        # The middle pixel is that of the feature (−1, −1), one row and one column further.
        last.weight.data[color * scale**2 : (color + 1) * scale**2, 4 * color, 2, 2] -= 1.0


def _cubic_taps(place: int, scale: int) -> Float64[np.ndarray, "5"]:
    """Return the weights of five pixels in one of the ``scale`` pixels that the middle one becomes."""
    distance = np.abs(np.arange(-2, 3) - ((place + 0.5) / scale - 0.5))
    a = _SHARPNESS
    near = (a + 2) * distance**3 - (a + 3) * distance**2 + 1
    far = a * (distance**3 - 5 * distance**2 + 8 * distance - 4)
    return np.where(distance < 1, near, np.where(distance < 2, far, 0.0))


def _half(taps: Float64[np.ndarray, "5"], shift: int) -> Float64[np.ndarray, "3"]:
    """Return the part of five weights that applies to pixels shifted by one: −2 … 0, or 1 and 2."""
    return taps[:3] if shift < 0 else np.concatenate([[0.0], taps[3:]])
