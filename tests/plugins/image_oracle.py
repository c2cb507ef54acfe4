"""Layers of image networks on [c, h, w] in float64 NumPy, for the oracles of several plugins."""

from collections.abc import Mapping

import numpy as np


def conv(
    w: Mapping[str, np.ndarray],
    name: str,
    x: np.ndarray,
    *,
    stride: int = 1,
    padding: int | None = None,
    mode: str = "constant",
    is_depthwise: bool = False,
) -> np.ndarray:
    """Convolve an image with the weights of a layer; the result of one tap after another."""
    weight = w[f"{name}.weight"]
    kernel = weight.shape[-1]
    edge = kernel // 2 if padding is None else padding
    padded = np.pad(x, ((0, 0), (edge, edge), (edge, edge)), mode=mode)
    height, width = (1 + (side - kernel) // stride for side in padded.shape[1:])
    result = np.zeros((len(weight), height, width))
    for v in range(kernel):
        for u in range(kernel):
            part = padded[:, v : v + stride * height : stride, u : u + stride * width : stride]
            part = part[:, :height, :width]
            tap = weight[:, :, v, u]
            result += part * tap[:, :1, None] if is_depthwise else np.tensordot(tap, part, 1)
    bias = w.get(f"{name}.bias")
    return result if bias is None else result + bias[:, None, None]


def leaky(x: np.ndarray, slope: float) -> np.ndarray:
    return np.where(x >= 0, x, slope * x)


def repeated(x: np.ndarray, scale: int) -> np.ndarray:
    """Return an image whose pixels are repeated along both axes."""
    return x.repeat(scale, axis=1).repeat(scale, axis=2)


def shuffled(x: np.ndarray, scale: int) -> np.ndarray:
    """Return an image whose pixel (scale y + v, scale x + u) was channel (c scale + v) scale + u."""
    channels, height, width = len(x) // scale**2, *x.shape[1:]
    result = np.zeros((channels, scale * height, scale * width))
    for channel in range(channels):
        for v in range(scale):
            for u in range(scale):
                result[channel, v::scale, u::scale] = x[(channel * scale + v) * scale + u]
    return result
