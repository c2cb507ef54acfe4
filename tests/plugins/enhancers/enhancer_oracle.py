"""What each enhancer computes, pixel by pixel or window by window, in float64 NumPy."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from plugins.image_oracle import conv, leaky, repeated, shuffled

Weights = Mapping[str, np.ndarray]


def restored(method: str, file: Path, image: np.ndarray) -> np.ndarray:
    """Return the image [3, h, w] as a network restores it, not clipped."""
    content = torch.load(file, weights_only=True)
    state = content.get("params_ema") or content.get("params") or content
    weights = {name: value.double().numpy() for name, value in state.items()}
    compute = {"rrdb": rrdb, "compact": compact, "swinir": swin_ir, "nafnet": naf_net}[method]
    height, width = image.shape[1:]
    result, scale = compute(weights, image.astype(np.float64))
    return result[:, : scale * height, : scale * width]


def filled_up(image: np.ndarray, multiple: int, mode: str) -> np.ndarray:
    bottom, right = (-side % multiple for side in image.shape[1:])
    return np.pad(image, ((0, 0), (0, bottom), (0, right)), mode=mode)


# ===== Real-ESRGAN


def rrdb(w: Weights, image: np.ndarray) -> tuple[np.ndarray, int]:
    block = math.isqrt(w["conv_first.weight"].shape[1] // 3)
    image = filled_up(image, block, "reflect")
    channels, height, width = image.shape
    gathered = np.zeros((channels * block**2, height // block, width // block))
    for channel in range(channels):
        for v in range(block):
            for u in range(block):
                gathered[(channel * block + v) * block + u] = image[channel, v::block, u::block]
    first = conv(w, "conv_first", gathered)
    x = first
    blocks = 1 + max(int(name.split(".")[1]) for name in w if name.startswith("body."))
    for index in range(blocks):
        inner = x
        for dense in ("rdb1", "rdb2", "rdb3"):
            seen, start = inner, inner
            for layer in range(1, 5):
                name = f"body.{index}.{dense}.conv{layer}"
                seen = np.concatenate([seen, leaky(conv(w, name, seen), 0.2)])
            inner = start + 0.2 * conv(w, f"body.{index}.{dense}.conv5", seen)
        x = x + 0.2 * inner
    x = first + conv(w, "conv_body", x)
    for name in ("conv_up1", "conv_up2"):
        x = leaky(conv(w, name, repeated(x, 2)), 0.2)
    return conv(w, "conv_last", leaky(conv(w, "conv_hr", x), 0.2)), 4 // block


def compact(w: Weights, image: np.ndarray) -> tuple[np.ndarray, int]:
    x, last = image, max(int(name.split(".")[1]) for name in w)
    for index in range(0, last, 2):
        x = conv(w, f"body.{index}", x)
        slope = w[f"body.{index + 1}.weight"][:, None, None]
        x = np.where(x >= 0, x, slope * x)
    x = conv(w, f"body.{last}", x)
    scale = math.isqrt(len(x) // 3)
    return shuffled(x, scale) + repeated(image, scale), scale


# ===== NAFNet


def naf_block(w: Weights, name: str, x: np.ndarray) -> np.ndarray:
    def norm(index: int, y: np.ndarray) -> np.ndarray:
        mean, variance = y.mean(0), y.var(0)
        weight, bias = (w[f"{name}.norm{index}.{kind}"] for kind in ("weight", "bias"))
        return (y - mean) / np.sqrt(variance + 1e-6) * weight[:, None, None] + bias[:, None, None]

    def gate(y: np.ndarray) -> np.ndarray:
        return y[: len(y) // 2] * y[len(y) // 2 :]

    y = conv(w, f"{name}.conv1", norm(1, x))
    y = gate(conv(w, f"{name}.conv2", y, is_depthwise=True))
    y = y * conv(w, f"{name}.sca.1", y.mean((1, 2), keepdims=True))
    x = x + conv(w, f"{name}.conv3", y) * w[f"{name}.beta"][0]
    y = gate(conv(w, f"{name}.conv4", norm(2, x)))
    return x + conv(w, f"{name}.conv5", y) * w[f"{name}.gamma"][0]


def naf_net(w: Weights, image: np.ndarray) -> tuple[np.ndarray, int]:
    def blocks(prefix: str, x: np.ndarray) -> np.ndarray:
        names = {name.removeprefix(prefix).split(".")[0] for name in w if name.startswith(prefix)}
        for number in sorted(names, key=int):
            x = naf_block(w, f"{prefix}{number}", x)
        return x

    levels = len({name.split(".")[1] for name in w if name.startswith("downs.")})
    padded = filled_up(image, 2**levels, "constant")
    x, skipped = conv(w, "intro", padded), []
    for level in range(levels):
        x = blocks(f"encoders.{level}.", x)
        skipped.append(x)
        x = conv(w, f"downs.{level}", x, stride=2, padding=0)
    x = blocks("middle_blks.", x)
    for level in range(levels):
        grown = np.tensordot(w[f"ups.{level}.0.weight"][:, :, 0, 0], x, 1)
        x = blocks(f"decoders.{level}.", shuffled(grown, 2) + skipped.pop())
    return conv(w, "ending", x) + padded, 1


# ===== SwinIR


def layer_norm(w: Weights, name: str, x: np.ndarray) -> np.ndarray:
    """Over the last axis."""
    deviation = np.sqrt(x.var(-1, keepdims=True) + 1e-5)
    return (x - x.mean(-1, keepdims=True)) / deviation * w[f"{name}.weight"] + w[f"{name}.bias"]


def attended(w: Weights, name: str, pixels: np.ndarray, window: int, shift: int) -> np.ndarray:
    """Attention [h, w, c] in windows whose corners lie at multiples of ``window``, plus ``shift``.

    A pixel attends to those of its shifted window; at the end of the image a window continues at
    its beginning, but pixels do not attend across that seam.
    """
    height, width, channels = pixels.shape
    table = w[f"{name}.relative_position_bias_table"]
    heads, result = table.shape[1], np.zeros_like(pixels)
    size = channels // heads
    offsets = range(window)
    for top in range(shift, shift + height, window):
        for left in range(shift, shift + width, window):
            places = [(top + i, left + j) for i in offsets for j in offsets]
            inside = np.stack([pixels[r % height, c % width] for r, c in places])
            qkv = inside @ w[f"{name}.qkv.weight"].T + w[f"{name}.qkv.bias"]
            gathered = np.zeros_like(inside)
            for head in range(heads):
                query, key, value = (
                    qkv[:, part * channels + head * size : part * channels + (head + 1) * size]
                    for part in range(3)
                )
                logits = query @ key.T / math.sqrt(size)
                for a, (row_a, column_a) in enumerate(places):
                    for b, (row_b, column_b) in enumerate(places):
                        place = (row_a - row_b + window - 1) * (2 * window - 1)
                        logits[a, b] += table[place + column_a - column_b + window - 1, head]
                        is_apart = row_a // height != row_b // height
                        is_apart |= column_a // width != column_b // width
                        logits[a, b] -= 100.0 * is_apart
                shares = np.exp(logits - logits.max(1, keepdims=True))
                shares /= shares.sum(1, keepdims=True)
                gathered[:, head * size : (head + 1) * size] = shares @ value
            projected = gathered @ w[f"{name}.proj.weight"].T + w[f"{name}.proj.bias"]
            for (row, column), value in zip(places, projected, strict=True):
                result[row % height, column % width] = value
    return result


def swin_block(w: Weights, name: str, pixels: np.ndarray, window: int, shift: int) -> np.ndarray:
    normalised = layer_norm(w, f"{name}.norm1", pixels)
    pixels = pixels + attended(w, f"{name}.attn", normalised, window, shift)
    hidden = layer_norm(w, f"{name}.norm2", pixels) @ w[f"{name}.mlp.fc1.weight"].T
    hidden = hidden + w[f"{name}.mlp.fc1.bias"]
    normal = 0.5 * (1 + np.vectorize(math.erf)(hidden / math.sqrt(2)))
    return pixels + (hidden * normal) @ w[f"{name}.mlp.fc2.weight"].T + w[f"{name}.mlp.fc2.bias"]


def last_convolution(w: Weights, name: str, x: np.ndarray) -> np.ndarray:
    if f"{name}.weight" in w:
        return conv(w, name, x)
    for index in (0, 2):
        x = leaky(conv(w, f"{name}.{index}", x), 0.2)
    return conv(w, f"{name}.4", x)


def swin_ir(w: Weights, image: np.ndarray) -> tuple[np.ndarray, int]:
    table = w["layers.0.residual_group.blocks.0.attn.relative_position_bias_table"]
    window = (math.isqrt(len(table)) + 1) // 2
    levels = 255.0 if window == 7 else 1.0
    mean = np.array([0.4488, 0.4371, 0.4040])[:, None, None]
    image = filled_up(image, window, "reflect")
    first = conv(w, "conv_first", (image - mean) * levels)
    pixels = layer_norm(w, "patch_embed.norm", first.transpose(1, 2, 0))
    for layer in sorted({int(name.split(".")[1]) for name in w if name.startswith("layers.")}):
        start, prefix = pixels, f"layers.{layer}.residual_group.blocks."
        for block in sorted({int(name.split(".")[4]) for name in w if name.startswith(prefix)}):
            shift = window // 2 if block % 2 else 0
            pixels = swin_block(w, f"{prefix}{block}", pixels, window, shift)
        convolved = last_convolution(w, f"layers.{layer}.conv", pixels.transpose(2, 0, 1))
        pixels = start + convolved.transpose(1, 2, 0)
    x = layer_norm(w, "norm", pixels).transpose(2, 0, 1)
    x = first + last_convolution(w, "conv_after_body", x)
    if "conv_up1.weight" in w:
        x, scale = leaky(conv(w, "conv_before_upsample.0", x), 0.01), 1
        for name in ("conv_up1", "conv_up2"):
            if f"{name}.weight" in w:
                x, scale = leaky(conv(w, name, repeated(x, 2)), 0.2), 2 * scale
        x = conv(w, "conv_last", leaky(conv(w, "conv_hr", x), 0.2))
    elif "conv_before_upsample.0.weight" in w:
        x, scale = leaky(conv(w, "conv_before_upsample.0", x), 0.01), 1
        for index in range(0, 6, 2):
            if f"upsample.{index}.weight" in w:
                grown = conv(w, f"upsample.{index}", x)
                factor = math.isqrt(len(grown) // len(x))
                x, scale = shuffled(grown, factor), factor * scale
        x = conv(w, "conv_last", x)
    elif "upsample.0.weight" in w:
        grown = conv(w, "upsample.0", x)
        scale = math.isqrt(len(grown) // 3)
        x = shuffled(grown, scale)
    else:
        return image + conv(w, "conv_last", x) / levels, 1
    return x / levels + mean, scale
