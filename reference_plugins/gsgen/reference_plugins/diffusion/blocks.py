"""What U-Nets and autoencoders of image diffusion are built of.

Attributes are called as in checkpoints of diffusers, so that a checkpoint's names are the
module's. Residual blocks are those of Ho et al. 2020, "Denoising Diffusion Probabilistic Models";
transformers those of Rombach et al. 2022, "High-Resolution Image Synthesis with Latent Diffusion
Models".
"""

__all__ = [
    "Attention",
    "Downsample",
    "ImageAttention",
    "Residual",
    "Transformer",
    "Upsample",
]

import math

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

_TRANSFORMER_EPS = 1e-6
_FEED_FORWARD = 4


class Residual(nn.Module):
    """Two convolutions around which the input is carried; a moment in time is added between.

    norm, SiLU, convolution; plus the projected time (or a scale and a shift of the second norm by
    it); norm, SiLU, convolution; plus the input, through a 1×1 convolution where channels differ.
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
        """Make the layers.

        Args:
            inputs: Channels that come in.
            outputs: Channels that go out.
            groups: Of both norms.
            eps: Of both norms.
            time: Length of the embedded time; none where absent.
            shifts: Time scales and shifts the second norm.
            shrink: What the sum is divided by.
        """
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
        """Apply the block."""
        made = self.conv1(F.silu(self.norm1(image)))
        moment = None
        if time is not None:
            moment = self.time_emb_proj(F.silu(time))[:, :, None, None]
        if moment is not None and self.shifts:
            scale, shift = moment.chunk(2, dim=1)
            made = self.norm2(made) * (1 + scale) + shift
        else:
            made = self.norm2(made if moment is None else made + moment)
        made = self.conv2(F.silu(made))
        kept = image if self.conv_shortcut is None else self.conv_shortcut(image)
        total: Tensor = kept + made
        return total if self.shrink == 1 else total / self.shrink


class Attention(nn.Module):
    """softmax(Q Kᵀ / √d) V of several heads (Vaswani et al. 2017, equation 1)."""

    def __init__(
        self,
        channels: int,
        heads: int,
        width: int,
        *,
        context: int | None = None,
        bias: bool = False,
    ) -> None:
        """Make the projections.

        Args:
            channels: Of what asks.
            heads: How many.
            width: Of one head.
            context: Channels of what is asked; the same where absent.
            bias: Of queries, keys and values.
        """
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
        """Ask ``context``, or the tokens themselves."""
        source = tokens if context is None else context
        query = self._split(self.to_q(tokens))
        key, value = self._split(self.to_k(source)), self._split(self.to_v(source))
        weight = torch.softmax(
            (query / math.sqrt(self.width)) @ key.transpose(2, 3), dim=-1
        )
        made = (weight @ value).transpose(1, 2).flatten(2)
        out: Tensor = self.to_out[0](made)
        return out

    def _split(self, rows: Tensor) -> Tensor:
        shape = (*rows.shape[:2], self.heads, self.width)
        return rows.reshape(shape).transpose(1, 2)


class ImageAttention(Attention):
    """Attention between the pixels of an image, which is carried around it."""

    def __init__(
        self,
        channels: int,
        heads: int,
        width: int,
        *,
        groups: int,
        eps: float,
        shrink: float = 1.0,
    ) -> None:
        """Make the layers; ``groups`` and ``eps`` are the norm's, ``shrink`` divides the sum."""
        super().__init__(channels, heads, width, bias=True)
        self.shrink = shrink
        self.group_norm = nn.GroupNorm(groups, channels, eps=eps)

    def forward(  # type: ignore[override]
        self, image: Float[Tensor, "b c h w"]
    ) -> Float[Tensor, "b c h w"]:
        """Apply the block."""
        # The norm sees the image: flattening first would ask for one more copy.
        tokens = self.group_norm(image).flatten(2).transpose(1, 2)
        made = super().forward(tokens).transpose(1, 2).reshape(image.shape)
        return (image + made) / self.shrink if self.shrink != 1 else image + made


class _FeedForward(nn.Module):
    """A layer gated by GELU (Shazeer 2020, "GLU Variants Improve Transformer"), and one back."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        inner = _FEED_FORWARD * channels
        gated = nn.Module()
        gated.proj = nn.Linear(channels, 2 * inner)
        self.net = nn.ModuleList([gated, nn.Identity(), nn.Linear(inner, channels)])

    def forward(self, tokens: Tensor) -> Tensor:
        gated: nn.Module = self.net[0]
        value, gate = gated.proj(tokens).chunk(2, dim=-1)  # type: ignore[operator]
        made: Tensor = self.net[2](value * F.gelu(gate))
        return made


class _TransformerBlock(nn.Module):
    """Attention to oneself, to the conditioning, and a feed-forward layer, each carried around."""

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
        made: Tensor = tokens + self.ff(self.norm3(tokens))
        return made


class Transformer(nn.Module):
    """Pixels as tokens that ask each other and the conditioning."""

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
        """Make the layers.

        Args:
            channels: Of the image.
            heads: Of each attention.
            groups: Of the norm.
            context: Length of one conditioning vector.
            depth: How many blocks.
            linear: Projections are linear layers, not 1×1 convolutions.
        """
        super().__init__()
        self.linear = linear
        self.norm = nn.GroupNorm(groups, channels, eps=_TRANSFORMER_EPS)
        self.proj_in = _projection(channels, linear)
        width = channels // heads
        self.transformer_blocks = nn.ModuleList(
            _TransformerBlock(channels, heads, width, context) for _ in range(depth)
        )
        self.proj_out = _projection(channels, linear)

    def forward(
        self, image: Float[Tensor, "b c h w"], context: Float[Tensor, "b m d"]
    ) -> Float[Tensor, "b c h w"]:
        """Apply all blocks."""
        made = self.norm(image)
        made = made if self.linear else self.proj_in(made)
        tokens = made.flatten(2).transpose(1, 2)
        tokens = self.proj_in(tokens) if self.linear else tokens
        for block in self.transformer_blocks:
            tokens = block(tokens, context)
        tokens = self.proj_out(tokens) if self.linear else tokens
        made = tokens.transpose(1, 2).reshape(image.shape)
        made = made if self.linear else self.proj_out(made)
        total: Tensor = image + made
        return total


def _projection(channels: int, linear: bool) -> nn.Module:
    return nn.Linear(channels, channels) if linear else nn.Conv2d(channels, channels, 1)


class Downsample(nn.Module):
    """Half the size, by a convolution of stride 2."""

    def __init__(self, channels: int, padding: int = 1) -> None:
        """Without padding, one row and one column of zeros are added behind the image."""
        super().__init__()
        self.behind = padding == 0
        self.conv = nn.Conv2d(channels, channels, 3, stride=2, padding=padding)

    def forward(self, image: Float[Tensor, "b c h w"]) -> Tensor:
        """Apply the convolution."""
        made: Tensor = self.conv(F.pad(image, (0, 1, 0, 1)) if self.behind else image)
        return made


class Upsample(nn.Module):
    """Twice the size: every pixel four times, then a convolution."""

    def __init__(self, channels: int) -> None:
        """Make the convolution."""
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, image: Float[Tensor, "b c h w"]) -> Tensor:
        """Apply both."""
        made: Tensor = self.conv(F.interpolate(image, scale_factor=2.0, mode="nearest"))
        return made
