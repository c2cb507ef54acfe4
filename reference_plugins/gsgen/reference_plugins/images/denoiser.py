"""One step of image diffusion as a post-process model: the renderer's image in, a cleaner one out.

A network that predicts noise ε at timestep t gives the clean image at once (Ho et al. 2020,
equation 15): x₀ = (x − √(1 − ᾱₜ) ε) / √ᾱₜ. Enhancers of rendered images such as Difix (Wu et al.
2025, "Difix3D+") take the rendered image, or its latent, for x.
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
from gsgen.reference_plugins.images.diffusion_checkpoint import DiffusionCheckpoint, Noise
from gsgen.sdk import PostProcess, inputs

# What the networks of diffusion call black and white, and what renderers do.
_SIGNED, _UNIT = (-1.0, 1.0), (0.0, 1.0)
_CHANNELS = (3, 4)
# Timesteps where nothing says how many there are.
_STEPS = 1000

Share = Tensor | float


@dataclass(frozen=True, slots=True)
class Step:
    """How the step is taken.

    Attributes:
        timestep: Which one.
        steers: The timestep is an input, and ``timestep`` only its default.
        size: Height and width of images; open where absent.
        unit: Images are 0 … 1 outside, not −1 … 1.
        raw: What the network predicts is the result, not the image that follows from it.
    """

    timestep: float
    steers: bool = False
    size: tuple[int, int] | None = None
    unit: bool = False
    raw: bool = False


@final
class Denoiser(PostProcess):
    """One step of a U-Net, in pixels or in the latents of an autoencoder.

    An image whose sides are not multiples of the stride is continued to the right and below by
    its edge, and cut again.
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
        """Take a checkpoint's networks.

        Args:
            read: The checkpoint.
            step: How the step is taken.
            context: Conditioning vectors, where the network takes them.
            vector: What is added to the embedded time, where the network wants that
                (:func:`gsgen.reference_plugins.diffusion.unet.added_vector`).

        Raises:
            ConfigInvalid: The step cannot be taken with this checkpoint.
        """
        super().__init__()
        _require(read, step, context, vector)
        self.unet, self.autoencoder = read.unet, read.autoencoder
        self.stride, self.step = read.stride, step
        self.noise = None if step.raw else read.noise
        if self.noise is not None:
            shares = _shares_of(self.noise)
            kept, lost = shares[math.floor(step.timestep + 0.5)].tolist()
            self.fixed: tuple[Share, Share] = (kept, lost)
            self.table = shares.float()  # no buffer: it stays float32 in a model of float16
        self.image_range = self.output_range = _UNIT if step.unit else _SIGNED
        outer = read.unet.options if read.autoencoder is None else read.autoencoder.options
        self.channels = 4 if outer.inputs == 4 else 3
        declared = [inputs.image(outer.inputs, step.size, range=self.image_range)]
        if step.steers:
            last = _last(read)
            declared.append(inputs.timestep(step.timestep, range=(0, last)))
        self.inputs = declared
        self.register_buffer("context", context)
        self.register_buffer("vector", vector)

    def forward(
        self, image: Float[Tensor, "1 c h w"], timestep: Float[Tensor, "1"] | None = None
    ) -> Float[Tensor, "1 c h w"]:
        """Return the image without what the network takes for noise."""
        height, width = image.shape[2], image.shape[3]
        made = self._stepped(
            self._padded(2 * image - 1 if self.step.unit else image), timestep
        )
        made = made[:, :, :height, :width]
        if self.step.raw:
            return made
        made = made.clamp(*_SIGNED)
        return made * 0.5 + 0.5 if self.step.unit else made

    def _padded(self, image: Tensor) -> Tensor:
        below, right = -image.shape[2] % self.stride, -image.shape[3] % self.stride
        if self.step.size is not None and not below and not right:
            return image
        return F.pad(image, (0, right, 0, below), mode="replicate")

    def _stepped(self, image: Tensor, timestep: Tensor | None) -> Tensor:
        coded, entered = image, list[Tensor]()
        if self.autoencoder is not None:
            coded, entered = self.autoencoder.encode(image)
        moment = torch.tensor([self.step.timestep]) if timestep is None else timestep
        predicted: Tensor = self.unet(coded, moment, self.context, self.vector)
        made = predicted
        if self.noise is not None:
            # √ᾱ is small at late timesteps, so this is computed in float32.
            kept, lost = self._shares(timestep)
            how = self.noise.prediction
            clean = _clean(how, coded.float(), predicted.float(), kept, lost)
            made = clean.to(image.dtype)
        if self.autoencoder is not None:
            made = self.autoencoder.decode(made, entered)
        return made

    def _shares(self, timestep: Tensor | None) -> tuple[Share, Share]:
        """Return √ᾱ and √(1 − ᾱ) of the timestep, which is rounded to one that there is."""
        if timestep is None:
            return self.fixed
        whole = torch.floor(timestep + 0.5).clamp(0.0, float(len(self.table) - 1))
        row = torch.index_select(self.table, 0, whole.to(torch.int32))
        return row[:, 0:1].reshape(1, 1, 1, 1), row[:, 1:2].reshape(1, 1, 1, 1)


def _shares_of(noise: Noise) -> Float[Tensor, "steps 2"]:
    return torch.stack([noise.kept.sqrt(), (1 - noise.kept).sqrt()], dim=1)


def _clean(how: str, noisy: Tensor, predicted: Tensor, kept: Share, lost: Share) -> Tensor:
    """Solve xₜ = √ᾱ x₀ + √(1 − ᾱ) ε for x₀."""
    if how == "epsilon":
        return (noisy - lost * predicted) / kept
    if how == "v_prediction":  # Salimans and Ho 2022, appendix D
        return kept * noisy - lost * predicted
    return predicted


def _last(read: DiffusionCheckpoint) -> int:
    return _STEPS - 1 if read.noise is None else len(read.noise.kept) - 1


def _require(
    read: DiffusionCheckpoint, step: Step, context: Tensor | None, vector: Tensor | None
) -> None:
    options = read.unet.options
    if read.autoencoder is None and options.context is not None and options.inputs == 4:
        what = "a conditional U-Net of 4 channels works on latents, and there is no autoencoder"
        hint = "Give the folder that holds unet/ and vae/, or --vae DIR."
        raise ConfigInvalid(what, where=str(read.folder), hint=hint)
    outer = options if read.autoencoder is None else read.autoencoder.options
    if not {outer.inputs, outer.outputs} <= set(_CHANNELS):
        what = f"takes {outer.inputs} channels and gives {outer.outputs}, wanted 3 or 4 of each"
        raise ConfigInvalid(what, where=str(read.folder))
    if not 0 <= step.timestep <= _last(read):
        what = f"{step.timestep:g} is no timestep of 0 to {_last(read)}"
        raise ConfigInvalid(what, where="--timestep")
    if read.noise is None and not step.raw:
        hint = "Give --result network for what the network predicts, or add the folder scheduler/."
        what = "nothing says how noise was added, so the image cannot be computed"
        raise ConfigInvalid(what, where=str(read.folder), hint=hint)
    if options.context is None and context is not None:
        raise ConfigInvalid("the network takes no conditioning", where="--embeddings")
    if options.context is not None and not _fits(context, options.context):
        seen = (
            "nothing was given" if context is None else f"given was {list(context.shape)}"
        )
        what = f"the network takes conditioning [1, L, {options.context}]; {seen}"
        hint = "Give --embeddings FILE.npz: what the text encoder makes of the prompt."
        raise ConfigInvalid(what, where="--embeddings", hint=hint)
    if (options.vector is None) != (vector is None):
        what = "takes no" if options.vector is None else "wants a"
        raise ConfigInvalid(
            f"the network {what} vector beside the prompt", where="--embeddings"
        )


def _fits(context: Tensor | None, width: int) -> bool:
    if context is None or context.ndim != 3:
        return False
    return context.shape[0] == 1 and context.shape[2] == width
