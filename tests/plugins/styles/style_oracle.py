"""What each style network computes, tap by tap, in float64 NumPy."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from plugins.image_oracle import conv, leaky, repeated
from plugins.styles.cases import Case

Weights = Mapping[str, np.ndarray]


def weights_of(file: Path) -> Weights:
    state = torch.load(file, weights_only=True)
    return {name: value.double().numpy() for name, value in state.items()}


def redrawn(case: Case, path: Path) -> np.ndarray:
    """Return the picture of a case [3, h, w] as its network redraws it, not clipped."""
    image = case.image()[0].astype(np.float64)
    if case.method == "adain":
        result = adain(path, image, case.style().transpose(2, 0, 1) / 255, case.amount)
    elif case.method == "anime_gan":
        result = anime_gan(weights_of(path), image, aligns_corners=case.align_corners)
    else:
        result = fast_neural_style(weights_of(path), image)
    return result[:, : image.shape[1], : image.shape[2]]


def mirrored(w: Weights, name: str, x: np.ndarray, stride: int = 1) -> np.ndarray:
    return conv(w, name, x, stride=stride, mode="reflect")


# ===== Fast neural style


def fast_neural_style(w: Weights, image: np.ndarray) -> np.ndarray:
    def norm(name: str, x: np.ndarray) -> np.ndarray:
        mean, variance = x.mean((1, 2), keepdims=True), x.var((1, 2), keepdims=True)
        normalised = (x - mean) / np.sqrt(variance + 1e-5)
        return normalised * w[f"{name}.weight"][:, None, None] + w[f"{name}.bias"][:, None, None]

    x = 255 * image
    for index, stride in ((1, 1), (2, 2), (3, 2)):
        x = np.maximum(norm(f"in{index}", mirrored(w, f"conv{index}.conv2d", x, stride)), 0)
    for block in sorted({name.split(".")[0] for name in w if name.startswith("res")}):
        y = np.maximum(norm(f"{block}.in1", mirrored(w, f"{block}.conv1.conv2d", x)), 0)
        x = x + norm(f"{block}.in2", mirrored(w, f"{block}.conv2.conv2d", y))
    for index in (1, 2):
        y = mirrored(w, f"deconv{index}.conv2d", repeated(x, 2))
        x = np.maximum(norm(f"in{index + 3}", y), 0)
    return mirrored(w, "deconv3.conv2d", x) / 255


# ===== AnimeGANv2


def group_norm(w: Weights, name: str, x: np.ndarray) -> np.ndarray:
    normalised = (x - x.mean()) / np.sqrt(x.var() + 1e-5)
    return normalised * w[f"{name}.weight"][:, None, None] + w[f"{name}.bias"][:, None, None]


def anime_layer(
    w: Weights, name: str, x: np.ndarray, stride: int = 1, *, is_depthwise: bool = False
) -> np.ndarray:
    edge = w[f"{name}.1.weight"].shape[-1] // 2
    before = 0 if stride == 2 else edge
    x = np.pad(x, ((0, 0), (before, edge), (before, edge)), mode="reflect")
    x = conv(w, f"{name}.1", x, stride=stride, padding=0, is_depthwise=is_depthwise)
    return leaky(group_norm(w, f"{name}.2", x), 0.2)


def bilinear(x: np.ndarray, size: tuple[int, int], *, aligns_corners: bool) -> np.ndarray:
    for axis, target in zip((1, 2), size, strict=True):
        source = x.shape[axis]
        place = np.arange(target) * (source - 1) / (target - 1)
        if not aligns_corners:
            place = np.clip((np.arange(target) + 0.5) * source / target - 0.5, 0, None)
        low = np.minimum(place.astype(int), source - 1)
        high, share = np.minimum(low + 1, source - 1), place - low
        share = np.expand_dims(share, [0, 3 - axis])
        x = x.take(low, axis) * (1 - share) + x.take(high, axis) * share
    return x


def anime_gan(w: Weights, image: np.ndarray, *, aligns_corners: bool) -> np.ndarray:
    x = 2 * image - 1
    for index, stride in ((0, 1), (1, 2), (2, 1)):
        x = anime_layer(w, f"block_a.{index}", x, stride)
    half = x.shape[1:]
    for index, stride in ((0, 2), (1, 1)):
        x = anime_layer(w, f"block_b.{index}", x, stride)
    numbers = sorted({int(name.split(".")[1]) for name in w if name.startswith("block_c.")})
    for number in numbers:
        name = f"block_c.{number}"
        if f"{name}.1.weight" in w:
            x = anime_layer(w, name, x)
            continue
        y = anime_layer(w, f"{name}.layers.0", x)
        y = anime_layer(w, f"{name}.layers.1", y, is_depthwise=True)
        y = group_norm(w, f"{name}.layers.3", conv(w, f"{name}.layers.2", y))
        x = x + y if len(x) == len(y) else y
    x = bilinear(x, half, aligns_corners=aligns_corners)
    for index in (0, 1):
        x = anime_layer(w, f"block_d.{index}", x)
    x = bilinear(x, image.shape[1:], aligns_corners=aligns_corners)
    for index in (0, 1, 2):
        x = anime_layer(w, f"block_e.{index}", x)
    return np.tanh(conv(w, "out_layer.0", x)) / 2 + 0.5


# ===== AdaIN


def encoded(w: Weights, x: np.ndarray) -> np.ndarray:
    x = conv(w, "0", x)
    for index in (2, 5, None, 9, 12, None, 16, 19, 22, 25, None, 29):
        if index is not None:
            x = np.maximum(mirrored(w, str(index), x), 0)
            continue
        odd = [(0, 0), *((0, side % 2) for side in x.shape[1:])]
        x = np.pad(x, odd, constant_values=-np.inf)
        x = np.maximum.reduce([x[:, v::2, u::2] for v in (0, 1) for u in (0, 1)])
    return x


def adain(folder: Path, image: np.ndarray, style: np.ndarray, amount: float) -> np.ndarray:
    encoder, decoder = weights_of(folder / "vgg_normalised.pth"), weights_of(folder / "decoder.pth")

    def statistics(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        variance = x.var((1, 2), keepdims=True, ddof=1)
        return x.mean((1, 2), keepdims=True), np.sqrt(variance + 1e-5)

    features = encoded(encoder, image)
    mean, deviation = statistics(features)
    style_mean, style_deviation = statistics(encoded(encoder, style))
    styled = (features - mean) / deviation * style_deviation + style_mean
    x = amount * styled + (1 - amount) * features
    for index in (1, 5, 8, 11, 14, 18, 21, 25):
        x = np.maximum(mirrored(decoder, str(index), x), 0)
        if index in (1, 14, 21):
            x = repeated(x, 2)
    return mirrored(decoder, "28", x)
