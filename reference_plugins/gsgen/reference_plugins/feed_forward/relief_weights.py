"""Weights set by formula: networks that raise a picture of a ball into a relief, for demos.

A network passes the pixels on through one of its skip connections, and all other weights are zero.
Each number comes as a pair +a, −a: silu(a) − silu(−a) = a, so that activations change nothing. The
last normalisation divides by statistics of the picture, which are known for the ball.
"""

__all__ = ["ball_picture", "set_lgm_relief", "set_splatter_relief"]

import math

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

State = dict[str, Tensor]

_RADIUS = 0.72  # of the ball, in half sides of the picture
_EDGE_BRIGHTNESS = 0.35
_BALL_COLOR = (0.95, 0.55, 0.12)
_OPACITY_BIAS, _OPACITY_SLOPE = 6.0, 14.0  # opaque where blue is low, clear where it is 1
_HARMONIC = 0.28209479177387814
_SPLATTER_RELIEF = 2.5
_LGM_COLOR_SLOPE, _LGM_RADIUS, _LGM_LOG_SCALE = 2.4, 0.36, -1.4


def ball_picture(side: int, *, stripes: int = 0) -> UInt8[np.ndarray, "h w 3"]:
    """Return a picture of a shaded ball on white, with stripes around it."""
    steps = (np.arange(side) + 0.5) / side * 2 - 1
    x, y = np.meshgrid(steps, steps)
    height = np.sqrt(np.maximum(0, 1 - (x**2 + y**2) / _RADIUS**2))
    light = _EDGE_BRIGHTNESS + (1 - _EDGE_BRIGHTNESS) * height
    colors = np.asarray(_BALL_COLOR) * light[..., None]
    colors[..., 1] *= np.where(np.sin(stripes * np.pi * y / _RADIUS) > 0.4, 0.4, 1.0)
    colors[height == 0] = 1
    return (colors * 255).round().astype(np.uint8)


def set_splatter_relief(state: State, name: str, side: int, blocks: int, focal: float) -> None:
    """Set the weights of a Splatter Image network; ``name`` is that of the network."""
    _clear(state, name)
    picture = ball_picture(side, stripes=6) / 255
    # Step 1: channels 4k and 4k + 1 are +a and −a of colour k, so that each is a group of its own.
    first = state[f"{name}.encoder.enc.{side}x{side}_conv.weight"]
    for color in range(3):
        first[4 * color, color, 1, 1], first[4 * color + 1, color, 1, 1] = 1.0, -1.0
    # Step 2: the last block takes them from its skip connection.
    last = state[f"{name}.encoder.dec.{side}x{side}_block{blocks}.skip.weight"]
    width = len(first)
    last[torch.arange(width), width + torch.arange(width), 0, 0] = 1.0
    # Step 3: a group of +a, −a, 0, 0 is divided by its deviation, the root of half the mean of a².
    output = state[f"{name}.encoder.dec.{side}x{side}_aux_conv.weight"]
    deviation = np.sqrt((picture**2).mean(axis=(0, 1)) / 2)
    head, bias = state[f"{name}.out.weight"], state[f"{name}.out.bias"]
    head[torch.arange(len(head)), torch.arange(len(head)), 0, 0] = 1.0

    def add(row: int, color: int, slope: float) -> None:
        share = slope * deviation[color]
        output[row, 4 * color, 1, 1] += share
        output[row, 4 * color + 1, 1, 1] -= share

    add(0, 0, -_SPLATTER_RELIEF)  # nearer where red is bright
    bias[0] = _SPLATTER_RELIEF * 0.7
    add(4, 2, -_OPACITY_SLOPE)
    bias[4] = _OPACITY_BIAS
    bias[5:8] = math.log(0.8 / focal)
    bias[8] = 1.0
    for color in range(3):
        add(12 + color, color, 1 / _HARMONIC)
        bias[12 + color] = -0.5 / _HARMONIC


def set_lgm_relief(state: State, side: int, last_level: int) -> None:
    """Set the weights of an LGM network whose way up ends one level below the pictures."""
    _clear(state, "")
    # Step 1: channels 2k and 2k + 1 are +a and −a of input k: colours, moments, directions.
    first = state["unet.conv_in.weight"]
    for channel in range(9):
        first[2 * channel, channel, 1, 1], first[2 * channel + 1, channel, 1, 1] = 1.0, -1.0
    width = len(first)
    indices = torch.arange(width)
    state["unet.down_blocks.0.downsample.weight"][indices, indices, 1, 1] = 1.0
    # Step 2: the last block takes them from its skip connection.
    shortcut = state[f"unet.up_blocks.{last_level}.nets.2.shortcut.weight"]
    shortcut[indices, shortcut.shape[1] - width + indices, 0, 0] = 1.0
    # Step 3: each channel is normalised to mean 0 and deviation 1, over every second pixel.
    picture = ball_picture(side)[::2, ::2] / 255
    mean, deviation = picture.mean(axis=(0, 1)), picture.std(axis=(0, 1))
    output, head, bias = state["unet.conv_out.weight"], state["conv.weight"], state["conv.bias"]
    head[torch.arange(len(head)), torch.arange(len(head)), 0, 0] = 1.0

    def add(row: int, channel: int, slope: float) -> None:
        output[row, 2 * channel, 1, 1] += slope
        output[row, 2 * channel + 1, 1, 1] -= slope

    for axis in range(3):
        add(axis, 6 + axis, _LGM_RADIUS)
    add(3, 2, -_OPACITY_SLOPE * deviation[2])
    bias[3] = _OPACITY_BIAS - _OPACITY_SLOPE * mean[2]
    bias[4:7] = _LGM_LOG_SCALE
    bias[7] = 1.0
    for color in range(3):
        add(11 + color, color, _LGM_COLOR_SLOPE * deviation[color])
        bias[11 + color] = _LGM_COLOR_SLOPE * (mean[color] - 0.5)


def _clear(state: State, prefix: str) -> None:
    """Set all weights of convolutions and biases to 0, and those of normalisations to 1."""
    for name, value in state.items():
        if name.startswith(prefix) and not name.endswith("resample_filter"):
            is_norm = name.endswith(".weight") and value.ndim == 1
            value.fill_(1.0 if is_norm else 0.0)
