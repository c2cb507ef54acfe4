"""U-Nets that predict noise: those of diffusers, called as one."""

__all__ = ["UNet", "added_vector", "unet_of"]

from collections.abc import Sequence
from typing import Any, TypeAlias

import torch
from diffusers import UNet2DConditionModel, UNet2DModel
from diffusers.models.embeddings import get_timestep_embedding
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.diffusion.model_config import ModelConfig, arguments_of
from gsgen.reference_plugins.diffusion.options import UNetOptions


class _UnconditionalUNet(UNet2DModel, nn.Module):  # type: ignore[misc]
    """A U-Net without conditioning; its parameters are those of diffusers."""

    options: UNetOptions

    def forward(
        self, image: Float[Tensor, "b i h w"], timesteps: Float[Tensor, " b"], *_: None
    ) -> Float[Tensor, "b o h w"]:
        """Return the prediction of the U-Net, such as noise."""
        network_output: Tensor = super().forward(image, timesteps, return_dict=False)[0]
        return network_output


class _ConditionalUNet(UNet2DConditionModel, nn.Module):  # type: ignore[misc]
    """A U-Net with conditioning vectors; its parameters are those of diffusers."""

    options: UNetOptions
    add_embedding: Any

    def forward(
        self,
        image: Float[Tensor, "b i h w"],
        timesteps: Float[Tensor, " b"],
        context: Float[Tensor, "b m d"],
        vector: Float[Tensor, "b v"] | None = None,
    ) -> Float[Tensor, "b o h w"]:
        """Return the prediction of the U-Net; :func:`added_vector` gives ``vector``."""
        added = {"vector": vector}
        network_output: Tensor = super().forward(
            image, timesteps, context, added_cond_kwargs=added, return_dict=False
        )[0]
        return network_output

    def get_aug_embed(
        self, emb: Tensor, encoder_hidden_states: Tensor, added_cond_kwargs: Any
    ) -> Any:
        """Embed the vector of prompt and image sizes, which is a constant of the model."""
        vector = added_cond_kwargs["vector"]
        return None if vector is None else self.add_embedding(vector)


UNet: TypeAlias = _UnconditionalUNet | _ConditionalUNet
"""A U-Net: levels down, a middle block, and levels up with skip connections."""


def unet_of(config: ModelConfig) -> UNet:
    """Return the U-Net that a ``config.json`` of diffusers describes, without weights.

    The sides of its images are multiples of the options' stride.
    """
    options = UNetOptions.of(config)
    kind = _UnconditionalUNet if options.context is None else _ConditionalUNet
    unet: UNet = kind(**arguments_of(kind, config))
    unet.options = options
    return unet


def added_vector(
    pooled: Float[Tensor, "1 p"], time_ids: Sequence[float], options: UNetOptions
) -> Float[Tensor, "1 v"]:
    """Return the vector of prompt and image sizes that SDXL adds to the embedded timestep.

    It joins the pooled prompt and the features of each size (Podell et al. 2023, section 2.2).

    ``time_ids`` are original height and width, top and left of the crop, target height and width.
    """
    vector = options.vector
    assert vector is not None
    features: Tensor = get_timestep_embedding(
        torch.tensor(time_ids),
        vector.features,
        flip_sin_to_cos=options.flip,
        downscale_freq_shift=options.shift,
    )
    joined_features = torch.cat([pooled.float(), features.reshape(1, -1)], dim=1)
    if joined_features.shape[1] != vector.length:
        lengths = f"{pooled.shape[1]} + {len(time_ids)} × {vector.features}"
        raise ValueError(
            f"the prompt vector and time ids have {lengths} = {joined_features.shape[1]} numbers, "
            f"expected {vector.length}"
        )
    return joined_features
