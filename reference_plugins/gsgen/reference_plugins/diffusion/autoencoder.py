"""The autoencoder between images and latents: that of diffusers, with Difix's skip connections.

The skip connections lead from the levels of the encoder to those of the decoder (Wu et al. 2025
take them from Parmar et al. 2024, "One-Step Image Translation with Text-to-Image Models").
"""

__all__ = ["SKIP_PREFIX", "Autoencoder", "autoencoder_of"]

from collections.abc import Sequence
from typing import Any

from diffusers import AutoencoderKL
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.diffusion.model_config import ModelConfig, arguments_of
from gsgen.reference_plugins.diffusion.options import AutoencoderOptions

# Name of the convolutions of skip connections; a number follows, from 1 for the coarsest.
SKIP_PREFIX = "skip_conv_"


class Autoencoder(AutoencoderKL, nn.Module):  # type: ignore[misc]
    """An image autoencoder; latents are means, not samples, so that frames are consistent."""

    options: AutoencoderOptions
    encoder: Any
    decoder: Any
    quant_conv: Any
    post_quant_conv: Any

    def encode(
        self, image: Float[Tensor, "b c h w"]
    ) -> tuple[Float[Tensor, "b l i j"], list[Tensor]]:
        """Return the latent of an image, scaled for the U-Net, and the skip connections."""
        encoder, skip_features = self.encoder, []
        features = encoder.conv_in(image)
        for level in encoder.down_blocks:
            skip_features.append(features)
            features = level(features)
        features = encoder.conv_norm_out(encoder.mid_block(features))
        moments: Tensor = encoder.conv_out(encoder.conv_act(features))
        if self.quant_conv is not None:
            moments = self.quant_conv(moments)
        mean = moments[:, : self.options.latent]
        return (mean - self.options.shift) * self.options.scale, skip_features

    def decode(
        self, latent: Float[Tensor, "b l i j"], skip_features: Sequence[Tensor] = ()
    ) -> Float[Tensor, "b c h w"]:
        """Decode a latent, with the skip connections of the encoder, to an image."""
        decoder = self.decoder
        unscaled_latent = latent / self.options.scale + self.options.shift
        if self.post_quant_conv is not None:
            unscaled_latent = self.post_quant_conv(unscaled_latent)
        features = decoder.mid_block(decoder.conv_in(unscaled_latent))
        for index, level in enumerate(decoder.up_blocks):
            if self.options.skips is not None:
                skip = getattr(decoder, f"{SKIP_PREFIX}{index + 1}")
                features = features + skip(skip_features[-1 - index] * self.options.skips)
            features = level(features)
        image: Tensor = decoder.conv_out(decoder.conv_act(decoder.conv_norm_out(features)))
        return image


def autoencoder_of(config: ModelConfig, *, skips: bool = False) -> Autoencoder:
    """Return the autoencoder that a ``config.json`` of diffusers describes, without weights.

    With ``skips``, it has the skip connections of Difix.
    """
    options = AutoencoderOptions.of(config, skips=skips)
    autoencoder = Autoencoder(**arguments_of(Autoencoder, config))
    autoencoder.options = options
    channels = options.channels[::-1]
    for index in range(len(channels) if skips else 0):
        previous_channels, skip_features = (
            channels[max(index - 1, 0)],
            channels[min(index + 1, len(channels) - 1)],
        )
        skip = nn.Conv2d(skip_features, previous_channels, 1, bias=False)
        setattr(autoencoder.decoder, f"{SKIP_PREFIX}{index + 1}", skip)
    return autoencoder
