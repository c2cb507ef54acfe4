"""SwinIR: attention within windows that are shifted from block to block.

Liang et al. 2021, "SwinIR: Image Restoration Using Swin Transformer" (arXiv 2108.10257, section 3),
with the windows and the relative positions of Liu et al. 2021, "Swin Transformer" (arXiv 2103.14030,
section 3.2).
"""

__all__ = ["SwinIR", "SwinIROptions", "Upsampler"]

from dataclasses import dataclass
from typing import Literal, final

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.enhancers.enhancer import ImageNetwork

Upsampler = Literal["shuffle", "shuffle-once", "nearest", "none"]
"""How the result gets its size: shuffled pixels, by one layer, repeated pixels, or not at all."""

_MEAN_COLOR = (0.4488, 0.4371, 0.4040)  # of DIV2K, which is subtracted
_OTHER_REGION = -100.0  # added to the logits of pixels that the shift brought together
_SLOPE, _UPSAMPLING_SLOPE = 0.01, 0.2  # of the leaky rectifiers, below zero


@dataclass(frozen=True, slots=True, kw_only=True)
class SwinIROptions:
    """The sizes of the network, as its weights tell them."""

    scale: int
    width: int
    depths: tuple[int, ...]  # blocks of each layer
    heads: int
    window: int  # pixels of a window's side
    hidden: int  # channels between the two linear layers of a block
    upsampler: Upsampler
    width_after: int  # channels where the size grows
    three_convolutions: bool  # at the end of a layer, instead of one
    has_bias: bool  # of queries, keys and values
    has_first_norm: bool


class _Attention(nn.Module):
    """Self-attention among the pixels of each window."""

    relative_position_index: Tensor

    def __init__(self, options: SwinIROptions) -> None:
        super().__init__()
        width, window = options.width, options.window
        self.heads = options.heads
        table = torch.zeros((2 * window - 1) ** 2, options.heads)
        self.relative_position_bias_table = nn.Parameter(table)
        self.qkv = nn.Linear(width, 3 * width, bias=options.has_bias)
        self.proj = nn.Linear(width, width)
        # Offsets of rows and columns from each pixel of a window to each other.
        place = torch.arange(window**2)
        rows = place[:, None] // window - place // window + window - 1
        columns = place[:, None] % window - place % window + window - 1
        index = rows * (2 * window - 1) + columns
        self.register_buffer("relative_position_index", index, persistent=False)

    def forward(
        self,
        windows: Float[Tensor, "rows columns n c"],
        masks: tuple[Float[Tensor, "rows 1 1 n n"], Float[Tensor, "1 columns 1 n n"]] | None,
    ) -> Float[Tensor, "rows columns n c"]:
        rows, columns, count, width = windows.shape
        size = width // self.heads
        # The scale of the queries is folded into their weights.
        factors = torch.ones(3 * width)
        factors[:width] = size**-0.5
        bias = None if self.qkv.bias is None else self.qkv.bias * factors
        projected = F.linear(windows, self.qkv.weight * factors[:, None], bias)
        projected = projected.reshape(rows, columns, count, 3, self.heads, size)
        query, key, value = projected.permute(3, 0, 1, 4, 2, 5).unbind()
        table = self.relative_position_bias_table[self.relative_position_index.reshape(-1)]
        logits = query @ key.transpose(-2, -1)
        logits = logits + table.T.reshape(self.heads, count, count)
        for mask in masks or ():
            logits = logits + mask
        attended = torch.softmax(logits, -1) @ value
        joined = attended.permute(0, 1, 3, 2, 4).reshape(rows, columns, count, width)
        result: Tensor = self.proj(joined)
        return result


class _Hidden(nn.Module):
    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(width, hidden), nn.Linear(hidden, width)

    def forward(self, pixels: Tensor) -> Tensor:
        result: Tensor = self.fc2(F.gelu(self.fc1(pixels)))
        return result


class _Block(nn.Module):
    """Attention within windows, and two linear layers, each with a norm before it."""

    def __init__(self, options: SwinIROptions, *, is_shifted: bool) -> None:
        super().__init__()
        self.window = options.window
        self.shift = options.window // 2 if is_shifted else 0
        self.norm1, self.norm2 = nn.LayerNorm(options.width), nn.LayerNorm(options.width)
        self.attn, self.mlp = _Attention(options), _Hidden(options.width, options.hidden)

    def forward(self, pixels: Float[Tensor, "h w c"]) -> Float[Tensor, "h w c"]:
        height, width, channels = pixels.shape
        window, shift = self.window, self.shift
        normalised = self.norm1(pixels)
        if shift:
            normalised = torch.roll(normalised, (-shift, -shift), (0, 1))
        rows, columns = height // window, width // window
        windows = normalised.reshape(rows, window, columns, window, channels).permute(0, 2, 1, 3, 4)
        attended = self.attn(
            windows.reshape(rows, columns, window**2, channels), self._masks(rows, columns)
        )
        attended = attended.reshape(rows, columns, window, window, channels).permute(0, 2, 1, 3, 4)
        attended = attended.reshape(height, width, channels)
        if shift:
            attended = torch.roll(attended, (shift, shift), (0, 1))
        result: Tensor = pixels + attended
        result = result + self.mlp(self.norm2(result))
        return result

    def _masks(
        self, rows: int, columns: int
    ) -> tuple[Float[Tensor, "rows 1 1 n n"], Float[Tensor, "1 columns 1 n n"]] | None:
        """Return what keeps the last windows from mixing opposite edges of the image."""
        if not self.shift:
            return None
        place = torch.arange(self.window**2)
        by_row = _differing(rows, self.window, self.shift, place // self.window)
        by_column = _differing(columns, self.window, self.shift, place % self.window)
        return by_row[:, None, None], by_column[None, :, None]


def _differing(count: int, window: int, shift: int, place: Tensor) -> Float[Tensor, "count n n"]:
    """Return the mask of pixels at a place along one axis that were apart before the shift."""
    is_wrapped = place >= window - shift
    differs = (is_wrapped[:, None] != is_wrapped).float() * _OTHER_REGION
    is_last = torch.arange(count) == count - 1
    return is_last[:, None, None].float() * differs


class _Layer(nn.Module):
    """Several blocks, a convolution, and a residual around them."""

    def __init__(self, options: SwinIROptions, depth: int) -> None:
        super().__init__()
        self.residual_group = nn.Module()
        blocks = [_Block(options, is_shifted=index % 2 == 1) for index in range(depth)]
        self.residual_group.blocks = nn.ModuleList(blocks)
        self.conv = _last_convolution(options)

    def forward(self, pixels: Float[Tensor, "h w c"]) -> Float[Tensor, "h w c"]:
        result = pixels
        for block in self.residual_group.blocks:  # type: ignore[union-attr]
            result = block(result)
        return _pixels_of(self.conv(_image_of(result))) + pixels


def _image_of(pixels: Float[Tensor, "h w c"]) -> Float[Tensor, "1 c h w"]:
    return pixels.permute(2, 0, 1)[None]


def _pixels_of(image: Float[Tensor, "1 c h w"]) -> Float[Tensor, "h w c"]:
    return image[0].permute(1, 2, 0)


def _last_convolution(options: SwinIROptions) -> nn.Module:
    width, narrow = options.width, options.width // 4
    if not options.three_convolutions:
        return nn.Conv2d(width, width, 3, padding=1)
    return nn.Sequential(
        nn.Conv2d(width, narrow, 3, padding=1),
        nn.LeakyReLU(_UPSAMPLING_SLOPE),
        nn.Conv2d(narrow, narrow, 1),
        nn.LeakyReLU(_UPSAMPLING_SLOPE),
        nn.Conv2d(narrow, width, 3, padding=1),
    )


@final
class SwinIR(ImageNetwork):
    """Layers of such blocks at the image's size, and an upsampler."""

    source = "https://github.com/JingyunLiang/SwinIR"

    def __init__(self, options: SwinIROptions) -> None:
        super().__init__()
        self.options, self.scale, self.multiple = options, options.scale, options.window
        width, after = options.width, options.width_after
        self.conv_first = nn.Conv2d(3, width, 3, padding=1)
        if options.has_first_norm:
            self.patch_embed = nn.Module()
            self.patch_embed.norm = nn.LayerNorm(width)
        self.layers = nn.ModuleList(_Layer(options, depth) for depth in options.depths)
        self.norm = nn.LayerNorm(width)
        self.conv_after_body = _last_convolution(options)
        if options.upsampler == "shuffle-once":
            self.upsample = nn.Sequential(
                nn.Conv2d(width, 3 * self.scale**2, 3, padding=1), nn.PixelShuffle(self.scale)
            )
            return
        if options.upsampler != "none":
            layer = nn.Conv2d(width, after, 3, padding=1)
            self.conv_before_upsample = nn.Sequential(layer, nn.LeakyReLU(_SLOPE))
        if options.upsampler == "shuffle":
            self.upsample = nn.Sequential(*_shuffles(self.scale, after))
        if options.upsampler == "nearest":
            self.conv_up1 = nn.Conv2d(after, after, 3, padding=1)
            if self.scale == 4:
                self.conv_up2 = nn.Conv2d(after, after, 3, padding=1)
            self.conv_hr = nn.Conv2d(after, after, 3, padding=1)
        self.conv_last = nn.Conv2d(width if options.upsampler == "none" else after, 3, 3, padding=1)

    def forward(self, image: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 3 sh sw"]:
        """Return the restored or enlarged image."""
        # The published models for 255 grey levels are those with windows of 7, against JPEG's 8.
        levels = 255.0 if self.options.window == 7 else 1.0
        mean = torch.tensor(_MEAN_COLOR)[None, :, None, None]
        centered = (image - mean) * levels
        first = self.conv_first(centered)
        pixels = _pixels_of(first)
        if self.options.has_first_norm:
            pixels = self.patch_embed.norm(pixels)  # type: ignore[operator]
        for layer in self.layers:
            pixels = layer(pixels)
        features = self.conv_after_body(_image_of(self.norm(pixels))) + first
        if self.options.upsampler == "none":
            restored: Tensor = image + self.conv_last(features) / levels
            return restored
        return self._enlarged(features) / levels + mean

    def _enlarged(self, features: Tensor) -> Tensor:
        result: Tensor
        if self.options.upsampler == "shuffle-once":
            result = self.upsample(features)
            return result
        features = self.conv_before_upsample(features)
        if self.options.upsampler == "shuffle":
            result = self.conv_last(self.upsample(features))
            return result
        layers = [self.conv_up1, self.conv_up2] if self.scale == 4 else [self.conv_up1]
        for layer in layers:
            doubled = F.interpolate(features, scale_factor=2.0, mode="nearest")
            features = F.leaky_relu(layer(doubled), _UPSAMPLING_SLOPE)
        result = self.conv_last(F.leaky_relu(self.conv_hr(features), _UPSAMPLING_SLOPE))
        return result

    def describe(self) -> str:
        """Return the method and the sizes of the network in a few words."""
        options = self.options
        depths = "+".join(map(str, options.depths))
        return (
            f"SwinIR × {self.scale}, {depths} blocks of width {options.width}, "
            f"windows of {options.window} × {options.window}"
        )


def _shuffles(scale: int, width: int) -> list[nn.Module]:
    """Return layers that enlarge by a power of two, or by three."""
    factors = [3] if scale == 3 else [2] * (scale.bit_length() - 1)
    layers: list[nn.Module] = []
    for factor in factors:
        layers += [nn.Conv2d(width, factor**2 * width, 3, padding=1), nn.PixelShuffle(factor)]
    return layers
