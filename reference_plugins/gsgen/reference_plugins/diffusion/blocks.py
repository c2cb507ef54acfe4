"""Building blocks of U-Nets and autoencoders: residual blocks, attention, resampling.

Attributes are named as in checkpoints of diffusers, so that state dicts load directly. Residual blocks are those of Ho et al. 2020, "Denoising Diffusion Probabilistic Models";
transformers those of Rombach et al. 2022, "High-Resolution Image Synthesis with Latent Diffusion
Models".
"""

__all__ = ["Attention", "Downsample", "ImageAttention", "Residual", "Transformer", "Upsample"]

import math

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

_TRANSFORMER_EPS = 1e-6
_FEED_FORWARD = 4


class Residual(nn.Module):
    """A residual block of two convolutions, conditioned on the timestep.

    norm, SiLU, convolution; plus the projected time (or it scales and shifts the second norm);
    norm, SiLU, convolution; plus the input, through a 1×1 convolution where channels differ.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        groups: int,
        eps: float,
        time: int | None = None,
        shifts: bool = False,
        shrink: float = 1.0,
    ) -> None:
        super().__init__()
        self.shifts, self.shrink = shifts, shrink
        self.norm1 = nn.GroupNorm(groups, inputs, eps=eps)
        self.conv1 = nn.Conv2d(inputs, outputs, 3, padding=1)
        if time is not None:
            self.time_emb_proj = nn.Linear(time, 2 * outputs if shifts else outputs)
        self.norm2 = nn.GroupNorm(groups, outputs, eps=eps)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1)
        self.conv_shortcut = nn.Conv2d(inputs, outputs, 1) if inputs != outputs else None

    def forward(
        self, image: Float[Tensor, "b i h w"], time: Float[Tensor, "b t"] | None = None
    ) -> Float[Tensor, "b o h w"]:
        """Apply the residual block to a feature image."""
        features = self.conv1(F.silu(self.norm1(image)))
        moment = None
        if time is not None:
            moment = self.time_emb_proj(F.silu(time))[:, :, None, None]
        if moment is not None and self.shifts:
            scale, shift = moment.chunk(2, dim=1)
            features = self.norm2(features) * (1 + scale) + shift
        else:
            features = self.norm2(features if moment is None else features + moment)
        features = self.conv2(F.silu(features))
        shortcut = image if self.conv_shortcut is None else self.conv_shortcut(image)
        total: Tensor = shortcut + features
        return total if self.shrink == 1 else total / self.shrink


class Attention(nn.Module):
    """Attention of several heads, softmax(Q Kᵀ / √d) V (Vaswani et al. 2017, equation 1)."""

    def __init__(
        self,
        channels: int,
        heads: int,
        width: int,
        *,
        context: int | None = None,
        bias: bool = False,
    ) -> None:
        super().__init__()
        self.heads, self.width = heads, width
        inner, source = heads * width, channels if context is None else context
        self.to_q = nn.Linear(channels, inner, bias=bias)
        self.to_k = nn.Linear(source, inner, bias=bias)
        self.to_v = nn.Linear(source, inner, bias=bias)
        self.to_out = nn.ModuleList([nn.Linear(inner, channels)])

    def forward(
        self, tokens: Float[Tensor, "b n c"], context: Float[Tensor, "b m d"] | None = None
    ) -> Float[Tensor, "b n c"]:
        """Attend from image tokens to conditioning vectors, or to the image tokens themselves."""
        source = tokens if context is None else context
        query = self._split(self.to_q(tokens))
        key, value = self._split(self.to_k(source)), self._split(self.to_v(source))
        weight = torch.softmax((query / math.sqrt(self.width)) @ key.transpose(2, 3), dim=-1)
        mixed = (weight @ value).transpose(1, 2).flatten(2)
        out: Tensor = self.to_out[0](mixed)
        return out

    def _split(self, rows: Tensor) -> Tensor:
        shape = (*rows.shape[:2], self.heads, self.width)
        return rows.reshape(shape).transpose(1, 2)


class ImageAttention(Attention):
    """Self-attention between the pixels of an image, with a residual connection."""

    def __init__(
        self, channels: int, heads: int, width: int, *, groups: int, eps: float, shrink: float = 1.0
    ) -> None:
        """Create self-attention between pixels, with group norm options and an output divisor."""
        super().__init__(channels, heads, width, bias=True)
        self.shrink = shrink
        self.group_norm = nn.GroupNorm(groups, channels, eps=eps)

    def forward(  # type: ignore[override]
        self, image: Float[Tensor, "b c h w"]
    ) -> Float[Tensor, "b c h w"]:
        """Apply self-attention to the pixels of a feature image."""
        # The norm is applied to the image: flattening first would need one more copy.
        tokens = self.group_norm(image).flatten(2).transpose(1, 2)
        attended = super().forward(tokens).transpose(1, 2).reshape(image.shape)
        return (image + attended) / self.shrink if self.shrink != 1 else image + attended


class _FeedForward(nn.Module):
    """A dense layer gated by GELU (Shazeer 2020, "GLU Variants"), then a linear layer."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        inner = _FEED_FORWARD * channels
        gated = nn.Module()
        gated.proj = nn.Linear(channels, 2 * inner)
        self.net = nn.ModuleList([gated, nn.Identity(), nn.Linear(inner, channels)])

    def forward(self, tokens: Tensor) -> Tensor:
        gated: nn.Module = self.net[0]
        value, gate = gated.proj(tokens).chunk(2, dim=-1)  # type: ignore[operator]
        output: Tensor = self.net[2](value * F.gelu(gate))
        return output


class _TransformerBlock(nn.Module):
    """Self-attention, cross-attention and a feed-forward layer, each with a residual connection."""

    def __init__(self, channels: int, heads: int, width: int, context: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels)
        self.attn1 = Attention(channels, heads, width)
        self.norm2 = nn.LayerNorm(channels)
        self.attn2 = Attention(channels, heads, width, context=context)
        self.norm3 = nn.LayerNorm(channels)
        self.ff = _FeedForward(channels)

    def forward(self, tokens: Tensor, context: Tensor) -> Tensor:
        tokens = tokens + self.attn1(self.norm1(tokens))
        tokens = tokens + self.attn2(self.norm2(tokens), context)
        output: Tensor = tokens + self.ff(self.norm3(tokens))
        return output


class Transformer(nn.Module):
    """A transformer on pixels, with cross-attention to the conditioning vectors."""

    def __init__(
        self,
        channels: int,
        heads: int,
        *,
        groups: int,
        context: int,
        depth: int = 1,
        linear: bool = False,
    ) -> None:
        super().__init__()
        self.linear = linear
        self.norm = nn.GroupNorm(groups, channels, eps=_TRANSFORMER_EPS)
        self.proj_in = _projection(channels, linear=linear)
        width = channels // heads
        self.transformer_blocks = nn.ModuleList(
            _TransformerBlock(channels, heads, width, context) for _ in range(depth)
        )
        self.proj_out = _projection(channels, linear=linear)

    def forward(
        self, image: Float[Tensor, "b c h w"], context: Float[Tensor, "b m d"]
    ) -> Float[Tensor, "b c h w"]:
        """Apply all transformer blocks to a feature image."""
        features = self.norm(image)
        features = features if self.linear else self.proj_in(features)
        tokens = features.flatten(2).transpose(1, 2)
        tokens = self.proj_in(tokens) if self.linear else tokens
        for block in self.transformer_blocks:
            tokens = block(tokens, context)
        tokens = self.proj_out(tokens) if self.linear else tokens
        features = tokens.transpose(1, 2).reshape(image.shape)
        features = features if self.linear else self.proj_out(features)
        total: Tensor = image + features
        return total


def _projection(channels: int, *, linear: bool) -> nn.Module:
    return nn.Linear(channels, channels) if linear else nn.Conv2d(channels, channels, 1)


class Downsample(nn.Module):
    """Halves the resolution by a convolution of stride 2."""

    def __init__(self, channels: int, padding: int = 1) -> None:
        """Create a convolution; if ``padding`` is 0, zeros extend the right and bottom edges."""
        super().__init__()
        self.behind = padding == 0
        self.conv = nn.Conv2d(channels, channels, 3, stride=2, padding=padding)

    def forward(self, image: Float[Tensor, "b c h w"]) -> Tensor:
        """Halve the resolution of a feature image."""
        output: Tensor = self.conv(F.pad(image, (0, 1, 0, 1)) if self.behind else image)
        return output


class Upsample(nn.Module):
    """Doubles the resolution by nearest-neighbour upsampling and a convolution."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, image: Float[Tensor, "b c h w"]) -> Tensor:
        """Double the resolution of a feature image."""
        output: Tensor = self.conv(F.interpolate(image, scale_factor=2.0, mode="nearest"))
        return output
