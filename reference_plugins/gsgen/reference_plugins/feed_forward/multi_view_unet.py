"""The asymmetric U-Net of LGM: residual blocks, and attention among the pixels of all pictures.

Its parameters have the names and shapes of the training code. It goes further down than up, so
that there are fewer Gaussians than pixels (Tang et al. 2024, section 3.3).
"""

__all__ = ["MultiViewUNet", "MultiViewUNetOptions"]

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

PICTURES = 4
"""Number of pictures of an object."""
LAYERS_DOWN = 2
"""Residual blocks of each level down; there is one more on the way up."""
HEADS, GROUPS = 16, 32
"""Attention heads, and groups of normalisation."""

_SKIP_SCALE = math.sqrt(0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiViewUNetOptions:
    """Sizes of an LGM network.

    Attributes:
        inputs: Channels of the input.
        outputs: Channels of the output.
        down: Channels of each level on the way down.
        down_attention: Whether each of these levels has attention.
        middle_attention: Whether the middle has attention.
        up: Channels of each level on the way up.
        up_attention: Whether each of these levels has attention.
    """

    inputs: int = 9
    outputs: int = 14
    down: tuple[int, ...]
    down_attention: tuple[bool, ...]
    middle_attention: bool
    up: tuple[int, ...]
    up_attention: tuple[bool, ...]

    @property
    def shrink(self) -> int:
        """How many times smaller a side of the output is than a side of the input."""
        return int(2 ** (len(self.down) - len(self.up)))


class MultiViewUNet(nn.Module):
    """A U-Net over the pictures of an object: [4, inputs, h, w] become [4, outputs, h', w']."""

    def __init__(self, options: MultiViewUNetOptions) -> None:
        super().__init__()
        self.options = options
        self.conv_in = _convolution(options.inputs, options.down[0])
        skips, channels = [options.down[0]], options.down[0]
        self.down_blocks = nn.ModuleList()
        for level, (width, attention) in enumerate(
            zip(options.down, options.down_attention, strict=True)
        ):
            is_last = level == len(options.down) - 1
            inputs = [channels] + [width] * (LAYERS_DOWN - 1)
            self.down_blocks.append(_Level(inputs, width, attention=attention))
            if not is_last:
                self.down_blocks[-1].downsample = _convolution(width, width, stride=2)
            skips += [width] * (LAYERS_DOWN + (not is_last))
            channels = width
        self.mid_block = _Middle(channels, attention=options.middle_attention)
        self.up_blocks = nn.ModuleList()
        for level, (width, attention) in enumerate(
            zip(options.up, options.up_attention, strict=True)
        ):
            inputs = []
            for number in range(LAYERS_DOWN + 1):
                inputs.append((channels if number == 0 else width) + skips.pop())
            self.up_blocks.append(_Level(inputs, width, attention=attention))
            if level < len(options.up) - 1:
                self.up_blocks[-1].upsample = _convolution(width, width)
            channels = width
        self.norm_out = _group_norm(channels)
        self.conv_out = _convolution(channels, options.outputs)

    def forward(self, pictures: Float[Tensor, "v i h w"]) -> Float[Tensor, "v o y x"]:
        """Return the features of each pixel of the smaller pictures."""
        x = self.conv_in(pictures)
        skips = [x]
        for block in self.down_blocks:
            assert isinstance(block, _Level)
            for layer in range(len(block.nets)):
                x = block.layer(layer, x)
                skips.append(x)
            if block.downsample is not None:
                x = block.downsample(x)
                skips.append(x)
        x = self.mid_block(x)
        for block in self.up_blocks:
            assert isinstance(block, _Level)
            for layer in range(len(block.nets)):
                x = block.layer(layer, torch.cat([x, skips.pop()], dim=1))
            if block.upsample is not None:
                x = functional.interpolate(x, scale_factor=2.0, mode="nearest")
                x = block.upsample(x)
        features: Tensor = self.conv_out(functional.silu(self.norm_out(x)))
        return features


class _Level(nn.Module):
    """The residual blocks of a level, each followed by attention if the level has it."""

    def __init__(self, inputs: list[int], width: int, *, attention: bool) -> None:
        super().__init__()
        self.nets = nn.ModuleList(_Residual(count, width) for count in inputs)
        self.attns = nn.ModuleList(_Attention(width) for _ in inputs if attention)
        self.downsample: nn.Conv2d | None = None
        self.upsample: nn.Conv2d | None = None

    def layer(self, number: int, x: Tensor) -> Tensor:
        """Return the result of one residual block and its attention."""
        features: Tensor = self.nets[number](x)
        return self.attns[number](features) if len(self.attns) else features


class _Middle(nn.Module):
    """Two residual blocks with attention between them."""

    def __init__(self, width: int, *, attention: bool) -> None:
        super().__init__()
        self.nets = nn.ModuleList([_Residual(width, width), _Residual(width, width)])
        self.attns = nn.ModuleList([_Attention(width)] if attention else [])

    def forward(self, x: Tensor) -> Tensor:
        x = self.nets[0](x)
        for attention in self.attns:
            x = attention(x)
        features: Tensor = self.nets[1](x)
        return features


class _Residual(nn.Module):
    """Two convolutions after normalisations, added to the input."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm1, self.conv1 = _group_norm(inputs), _convolution(inputs, outputs)
        self.norm2, self.conv2 = _group_norm(outputs), _convolution(outputs, outputs)
        self.shortcut = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        change = self.conv1(functional.silu(self.norm1(x)))
        change = self.conv2(functional.silu(self.norm2(change)))
        features: Tensor = (change + self.shortcut(x)) * _SKIP_SCALE
        return features


class _Projections(nn.Module):
    """The projections of an attention: to queries, keys and values, and back."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.qkv, self.proj = nn.Linear(width, 3 * width, bias=False), nn.Linear(width, width)


class _Attention(nn.Module):
    """Attention of each pixel to those of all pictures, added to the input."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm, self.attn = _group_norm(width), _Projections(width)

    def forward(self, x: Float[Tensor, "v c h w"]) -> Float[Tensor, "v c h w"]:
        count, channels, height, width = x.shape
        tokens = self.norm(x).flatten(2).transpose(1, 2).reshape(-1, channels)
        parts = self.attn.qkv(tokens).reshape(-1, 3, HEADS, channels // HEADS).permute(1, 2, 0, 3)
        query, key, value = parts.unbind(0)
        scores = (query * (channels // HEADS) ** -0.5) @ key.transpose(1, 2)
        attended = (torch.softmax(scores, dim=-1) @ value).transpose(0, 1).reshape(-1, channels)
        change: Tensor = self.attn.proj(attended).reshape(count, height * width, channels)
        return (change.transpose(1, 2).reshape(x.shape) + x) * _SKIP_SCALE


def _convolution(inputs: int, outputs: int, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1)


def _group_norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(GROUPS, channels, eps=1e-5)
