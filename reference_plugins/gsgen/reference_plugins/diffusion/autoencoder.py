"""The autoencoder between images and latents (AutoencoderKL of diffusers).

That of Difix also has skip connections from the levels of the encoder to those of the decoder (Wu et al. 2025 take them from Parmar et al. 2024, "One-Step Image
Translation with Text-to-Image Models").
"""

__all__ = ["SKIP", "Autoencoder"]

from collections.abc import Sequence

import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.diffusion.blocks import Downsample, ImageAttention, Residual, Upsample
from gsgen.reference_plugins.diffusion.options import AutoencoderOptions

_EPS = 1e-6
# Name of the convolutions of skip connections; a number follows, from 1 for the coarsest.
SKIP = "skip_conv_"


class _Level(nn.Module):
    """Residual blocks of one image resolution, then a change of resolution."""

    def __init__(self, options: AutoencoderOptions, inputs: int, outputs: int, layers: int) -> None:
        super().__init__()
        self.resnets = nn.ModuleList(
            _residual(options, inputs if i == 0 else outputs, outputs) for i in range(layers)
        )
        self.downsamplers: nn.ModuleList | None = None
        self.upsamplers: nn.ModuleList | None = None

    def forward(self, image: Tensor) -> Tensor:
        for block in self.resnets:
            image = block(image)
        for sampler in (self.downsamplers, self.upsamplers):
            image = image if sampler is None else sampler[0](image)
        return image


class _Middle(nn.Module):
    def __init__(self, options: AutoencoderOptions) -> None:
        super().__init__()
        width = options.channels[-1]
        self.resnets = nn.ModuleList(_residual(options, width, width) for _ in range(2))
        self.attends = options.attends
        if options.attends:
            self.attentions = nn.ModuleList(
                [ImageAttention(width, 1, width, groups=options.groups, eps=_EPS)]
            )

    def forward(self, image: Tensor) -> Tensor:
        image = self.resnets[0](image)
        if self.attends:
            image = self.attentions[0](image)
        output: Tensor = self.resnets[1](image)
        return output


def _residual(options: AutoencoderOptions, inputs: int, outputs: int) -> Residual:
    return Residual(inputs, outputs, groups=options.groups, eps=_EPS)


class _Encoder(nn.Module):
    def __init__(self, options: AutoencoderOptions) -> None:
        super().__init__()
        channels = options.channels
        self.conv_in = nn.Conv2d(options.inputs, channels[0], 3, padding=1)
        self.down_blocks = nn.ModuleList()
        for index, outputs in enumerate(channels):
            level = _Level(options, channels[max(index - 1, 0)], outputs, options.layers)
            if index < len(channels) - 1:
                level.downsamplers = nn.ModuleList([Downsample(outputs, padding=0)])
            self.down_blocks.append(level)
        self.mid_block = _Middle(options)
        self.conv_norm_out = nn.GroupNorm(options.groups, channels[-1], eps=_EPS)
        self.conv_out = nn.Conv2d(channels[-1], 2 * options.latent, 3, padding=1)

    def forward(self, image: Tensor) -> tuple[Tensor, list[Tensor]]:
        image = self.conv_in(image)
        entered = []
        for level in self.down_blocks:
            entered.append(image)
            image = level(image)
        moments: Tensor = self.conv_out(F.silu(self.conv_norm_out(self.mid_block(image))))
        return moments, entered


class _Decoder(nn.Module):
    def __init__(self, options: AutoencoderOptions) -> None:
        super().__init__()
        channels = options.channels[::-1]
        self.conv_in = nn.Conv2d(options.latent, channels[0], 3, padding=1)
        self.mid_block = _Middle(options)
        self.up_blocks = nn.ModuleList()
        for index, outputs in enumerate(channels):
            level = _Level(options, channels[max(index - 1, 0)], outputs, options.layers + 1)
            if index < len(channels) - 1:
                level.upsamplers = nn.ModuleList([Upsample(outputs)])
            self.up_blocks.append(level)
        self.conv_norm_out = nn.GroupNorm(options.groups, channels[-1], eps=_EPS)
        self.conv_out = nn.Conv2d(channels[-1], options.outputs, 3, padding=1)
        self.skips = options.skips
        for index in range(0 if options.skips is None else len(channels)):
            before = channels[max(index - 1, 0)]
            entered = channels[min(index + 1, len(channels) - 1)]
            skip = nn.Conv2d(entered, before, 1, bias=False)
            setattr(self, f"{SKIP}{index + 1}", skip)

    def forward(self, latent: Tensor, entered: Sequence[Tensor] = ()) -> Tensor:
        image = self.mid_block(self.conv_in(latent))
        for index, level in enumerate(self.up_blocks):
            if self.skips is not None:
                skip = getattr(self, f"{SKIP}{index + 1}")
                image = image + skip(entered[-1 - index] * self.skips)
            image = level(image)
        output: Tensor = self.conv_out(F.silu(self.conv_norm_out(image)))
        return output


class Autoencoder(nn.Module):
    """An image autoencoder; latents are means, not samples, so that frames are consistent."""

    def __init__(self, options: AutoencoderOptions) -> None:
        super().__init__()
        self.options = options
        before, behind = options.quantised
        self.encoder, self.decoder = _Encoder(options), _Decoder(options)
        moments, latent = 2 * options.latent, options.latent
        self.quant_conv = nn.Conv2d(moments, moments, 1) if before else None
        self.post_quant_conv = nn.Conv2d(latent, latent, 1) if behind else None

    def encode(
        self, image: Float[Tensor, "b c h w"]
    ) -> tuple[Float[Tensor, "b l i j"], list[Tensor]]:
        """Return the latent of an image, scaled for the U-Net, and the skip connections."""
        moments, entered = self.encoder(image)
        if self.quant_conv is not None:
            moments = self.quant_conv(moments)
        mean: Tensor = moments[:, : self.options.latent]
        return (mean - self.options.shift) * self.options.scale, entered

    def decode(
        self, latent: Float[Tensor, "b l i j"], entered: Sequence[Tensor] = ()
    ) -> Float[Tensor, "b c h w"]:
        """Decode a latent, with the skip connections of the encoder, to an image."""
        unscaled = latent / self.options.scale + self.options.shift
        if self.post_quant_conv is not None:
            unscaled = self.post_quant_conv(unscaled)
        image: Tensor = self.decoder(unscaled, entered)
        return image
