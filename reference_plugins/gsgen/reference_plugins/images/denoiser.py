"""A post-process model that cleans the rendered image by one step of a diffusion network.

A network that predicts noise ε at timestep t determines the clean image directly (Ho et al. 2020,
equation 15): x₀ = (x − √(1 − ᾱₜ) ε) / √ᾱₜ. Enhancers of rendered images such as Difix (Wu et al.
2025, "Difix3D+") use the rendered image, or its latent, as x.
"""

__all__ = ["Denoiser", "Step"]

import math
from dataclasses import dataclass
from typing import final

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.fields.roles import IMAGE_CHANNELS
from gsgen.reference_plugins.images.diffusion_checkpoint import DiffusionCheckpoint, Noise
from gsgen.sdk import PostProcess, inputs

# Black and white in diffusion networks, and in renderers.
_SIGNED_RANGE, _UNIT_RANGE = (-1.0, 1.0), (0.0, 1.0)
# Number of timesteps of a checkpoint without a schedule.
_TRAINING_TIMESTEPS = 1000

SignalShare = Tensor | float


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Options of the denoising step of a diffusion network."""

    timestep: float
    timestep_is_input: bool = False  # the timestep is an input, and ``timestep`` its default
    size: tuple[int, int] | None = None  # height and width of images; None for any size
    is_unit_range: bool = False  # images of the model are 0 … 1, not −1 … 1
    returns_prediction: bool = False  # the result is the network's prediction, not the clean image


@final
class Denoiser(PostProcess):
    """One denoising step of a U-Net, in pixels or in the latents of an autoencoder.

    An image whose sides are not multiples of the stride is padded by its edge on the right and at
    the bottom, and cropped afterwards.
    """

    family = "diffusion"

    context: Tensor | None
    vector: Tensor | None

    def __init__(
        self,
        read: DiffusionCheckpoint,
        step: Step,
        context: Float[Tensor, "1 m d"] | None = None,
        vector: Float[Tensor, "1 v"] | None = None,
    ) -> None:
        """Combine the networks of a diffusion checkpoint into one model.

        ``context`` are conditioning vectors, and ``vector`` is that of
        :func:`gsgen.reference_plugins.diffusion.unet.added_vector`, if the network takes them.
        """
        super().__init__()
        _check_step(read, step, context, vector)
        self.unet, self.autoencoder = read.unet, read.autoencoder
        self.stride, self.step = read.stride, step
        self.noise = None if step.returns_prediction else read.noise
        if self.noise is not None:
            signal_shares = _signal_and_noise(self.noise)
            signal, noise = signal_shares[math.floor(step.timestep + 0.5)].tolist()
            self.fixed_shares: tuple[SignalShare, SignalShare] = (signal, noise)
            self.table = signal_shares.float()  # not a buffer: it stays float32 in a float16 model
        self.image_range = self.output_range = _UNIT_RANGE if step.is_unit_range else _SIGNED_RANGE
        outer_options = read.unet.options if read.autoencoder is None else read.autoencoder.options
        self.channels = 4 if outer_options.inputs == 4 else 3
        declared = [inputs.image(outer_options.inputs, step.size, range=self.image_range)]
        if step.timestep_is_input:
            last_timestep = _last_timestep(read)
            declared.append(inputs.timestep(step.timestep, range=(0, last_timestep)))
        self.inputs = declared
        self.register_buffer("context", context)
        self.register_buffer("vector", vector)

    def forward(
        self, image: Float[Tensor, "1 c h w"], timestep: Float[Tensor, "1"] | None = None
    ) -> Float[Tensor, "1 c h w"]:
        """Return the image without the noise that the U-Net predicts."""
        height, width = image.shape[2], image.shape[3]
        result = self._denoise(
            self._pad_image(2 * image - 1 if self.step.is_unit_range else image), timestep
        )
        result = result[:, :, :height, :width]
        if self.step.returns_prediction:
            return result
        result = result.clamp(*_SIGNED_RANGE)
        return result * 0.5 + 0.5 if self.step.is_unit_range else result

    def _pad_image(self, image: Tensor) -> Tensor:
        bottom_padding, right_padding = -image.shape[2] % self.stride, -image.shape[3] % self.stride
        if self.step.size is not None and not bottom_padding and not right_padding:
            return image
        return F.pad(image, (0, right_padding, 0, bottom_padding), mode="replicate")

    def _denoise(self, image: Tensor, timestep: Tensor | None) -> Tensor:
        encoded, skip_features = image, list[Tensor]()
        if self.autoencoder is not None:
            encoded, skip_features = self.autoencoder.encode(image)
        timestep_tensor = torch.tensor([self.step.timestep]) if timestep is None else timestep
        network_output: Tensor = self.unet(encoded, timestep_tensor, self.context, self.vector)
        result = network_output
        if self.noise is not None:
            # √ᾱ is small at late timesteps, so this is computed in float32.
            signal, noise = self._signal_and_noise_at(timestep)
            prediction = self.noise.prediction
            clean_image = _clean_image(
                prediction, encoded.float(), network_output.float(), signal, noise
            )
            result = clean_image.to(image.dtype)
        if self.autoencoder is not None:
            result = self.autoencoder.decode(result, skip_features)
        return result

    def _signal_and_noise_at(self, timestep: Tensor | None) -> tuple[SignalShare, SignalShare]:
        """Return √ᾱ and √(1 − ᾱ) at a timestep, rounded to the nearest step of the schedule."""
        if timestep is None:
            return self.fixed_shares
        whole = torch.floor(timestep + 0.5).clamp(0.0, float(len(self.table) - 1))
        row = torch.index_select(self.table, 0, whole.to(torch.int32))
        return row[:, 0:1].reshape(1, 1, 1, 1), row[:, 1:2].reshape(1, 1, 1, 1)


def _signal_and_noise(noise: Noise) -> Float[Tensor, "steps 2"]:
    return torch.stack([noise.signal.sqrt(), (1 - noise.signal).sqrt()], dim=1)


def _clean_image(
    prediction: str,
    noisy_image: Tensor,
    network_output: Tensor,
    signal: SignalShare,
    noise: SignalShare,
) -> Tensor:
    """Solve xₜ = √ᾱ x₀ + √(1 − ᾱ) ε for the clean image x₀."""
    if prediction == "epsilon":
        return (noisy_image - noise * network_output) / signal
    if prediction == "v_prediction":  # Salimans and Ho 2022, appendix D
        return signal * noisy_image - noise * network_output
    return network_output


def _last_timestep(read: DiffusionCheckpoint) -> int:
    return _TRAINING_TIMESTEPS - 1 if read.noise is None else len(read.noise.signal) - 1


def _check_step(
    read: DiffusionCheckpoint, step: Step, context: Tensor | None, vector: Tensor | None
) -> None:
    options = read.unet.options
    if read.autoencoder is None and options.context is not None and options.inputs == 4:
        message = (
            "a conditional U-Net of 4 channels works on latents, but the autoencoder is missing"
        )
        hint = "Give the folder that holds unet/ and vae/, or --vae DIR."
        raise ConfigInvalid(message, where=str(read.folder), hint=hint)
    outer_options = options if read.autoencoder is None else read.autoencoder.options
    if not {outer_options.inputs, outer_options.outputs} <= set(IMAGE_CHANNELS):
        message = f"takes {outer_options.inputs} channels and returns {outer_options.outputs}, expected 3 or 4 of each"
        raise ConfigInvalid(message, where=str(read.folder))
    if not 0 <= step.timestep <= _last_timestep(read):
        message = f"{step.timestep:g} is not a timestep: expected 0 to {_last_timestep(read)}"
        raise ConfigInvalid(message, where="--timestep")
    if read.noise is None and not step.returns_prediction:
        hint = "Give --result network for the network's prediction, or add the folder scheduler/."
        message = "the schedule of noise is missing, so the clean image cannot be computed"
        raise ConfigInvalid(message, where=str(read.folder), hint=hint)
    if options.context is None and context is not None:
        raise ConfigInvalid("the network takes no conditioning", where="--embeddings")
    if options.context is not None and not _has_context_width(context, options.context):
        actual = (
            "--embeddings is missing"
            if context is None
            else f"--embeddings has {list(context.shape)}"
        )
        message = f"the network takes conditioning [1, L, {options.context}]; {actual}"
        hint = "Give --embeddings FILE.npz: the text encoder's embeddings of the prompt."
        raise ConfigInvalid(message, where="--embeddings", hint=hint)
    if (options.vector is None) != (vector is None):
        needs_text = "takes no" if options.vector is None else "needs a"
        raise ConfigInvalid(f"the network {needs_text} pooled prompt vector", where="--embeddings")


def _has_context_width(context: Tensor | None, width: int) -> bool:
    if context is None or context.ndim != 3:
        return False
    return context.shape[0] == 1 and context.shape[2] == width
