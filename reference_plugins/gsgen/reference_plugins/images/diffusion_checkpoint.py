"""Checkpoints of image diffusion in the layout of diffusers.

A folder holds ``unet/`` and, where the U-Net works on latents, ``vae/``; ``scheduler/`` says how
noise was added. Each network is a ``config.json`` and ``diffusion_pytorch_model.safetensors`` (or
``.bin``). The folder of a U-Net alone will do, too. LoRA files, and what Difix trained, are added
to the weights as they are read.
"""

__all__ = ["DiffusionCheckpoint", "Noise", "read_diffusion"]

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.diffusion.autoencoder import SKIP, Autoencoder
from gsgen.reference_plugins.diffusion.lora import Adapter, read_lora
from gsgen.reference_plugins.diffusion.lora_homes import homes_of
from gsgen.reference_plugins.diffusion.lora_merge import merge
from gsgen.reference_plugins.diffusion.model_config import ModelConfig, read_model_config
from gsgen.reference_plugins.diffusion.options import AutoencoderOptions, UNetOptions
from gsgen.reference_plugins.diffusion.unet import UNet
from gsgen.reference_plugins.images.difix import Difix, fused, read_difix
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.safetensors import read_safetensors
from gsgen.reference_plugins.loading.states import load_state, require_tensors

_Net = TypeVar("_Net", bound=nn.Module)

Prediction = Literal["epsilon", "v_prediction", "sample"]

_PREDICTIONS = ("epsilon", "v_prediction", "sample")
_WEIGHTS = "diffusion_pytorch_model"
_SCHEDULE = "scheduler_config.json"
# Names of attention in files from before 2023.
_OLD = {"query": "to_q", "key": "to_k", "value": "to_v", "proj_attn": "to_out.0"}
_LARGEST_BETA = 0.999


@dataclass(frozen=True, slots=True)
class Noise:
    """How noise was added in training.

    Attributes:
        kept: ᾱ of each timestep: the share of the image's variance that is left, float64.
        prediction: What the network was trained to predict.
    """

    kept: Float[Tensor, " steps"]
    prediction: Prediction


@dataclass(frozen=True, slots=True)
class DiffusionCheckpoint:
    """Everything that one step needs.

    Attributes:
        folder: What was read.
        unet: The network, its weights loaded.
        autoencoder: What carries images to latents, where there is one.
        noise: How noise was added, where the folder says it.
        digest: SHA-256 of the weights' files, one after the other.
        added: What was added to the weights, in words.
        warnings: What of it has no effect, in words.
    """

    folder: Path
    unet: UNet
    autoencoder: Autoencoder | None
    noise: Noise | None
    digest: str
    added: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def stride(self) -> int:
        """What sides of an image must be multiples of."""
        pixels = 1 if self.autoencoder is None else self.autoencoder.options.stride
        return pixels * self.unet.options.stride

    @property
    def size(self) -> tuple[int, int] | None:
        """Height and width of images that training saw, if told."""
        sample = self.unet.options.sample
        pixels = 1 if self.autoencoder is None else self.autoencoder.options.stride
        return None if sample is None else (pixels * sample[0], pixels * sample[1])

    def describe(self) -> str:
        """Say in one line what the checkpoint holds."""
        options = self.unet.options
        count = sum(weight.numel() for weight in self.unet.parameters())
        parts = [f"U-Net of {count:,} weights, {len(options.channels)} levels"]
        parts += [f"conditioning of {options.context}"] if options.context else []
        if self.autoencoder is not None:
            pixels = self.autoencoder.options.stride
            skips = self.autoencoder.options.skips is not None
            what = "autoencoder" + " with skip connections" * skips
            parts.append(f"{what}, 1/{pixels} of the size")
        if self.noise is not None:
            steps = f"{len(self.noise.kept)} timesteps"
            parts.append(f"{steps}, predicts {self.noise.prediction}")
        parts += [f"LoRA {one}" for one in self.added]
        return f"{self.folder}: {', '.join(parts)}; sides are multiples of {self.stride}"


def read_diffusion(
    folder: Path,
    vae: Path | None = None,
    *,
    difix: Path | None = None,
    loras: Sequence[tuple[Path, float]] = (),
) -> DiffusionCheckpoint:
    """Read a checkpoint.

    Args:
        folder: What holds ``unet/``, or a U-Net itself.
        vae: The autoencoder's folder; ``vae/`` in the first one where absent, if there is one.
        difix: What Difix trained on top.
        loras: LoRA files, and what each is multiplied by.

    Raises:
        CheckpointInvalid: Something is missing, does not fit the rest, or is not supported.
    """
    change = Difix() if difix is None else read_difix(difix)
    place = folder / "unet" if (folder / "unet").is_dir() else folder
    unet = _network(place, _unet, change.unet, difix)
    read: list[_Read[Any]] = [unet]
    autoencoder = None
    if vae is not None or (folder / "vae").is_dir():
        home = vae or folder / "vae"
        home = home / "vae" if (home / "vae").is_dir() else home
        coder = _network(home, _autoencoder, change.vae, difix)
        _require_latents(unet.network, coder.network, place)
        read.append(coder)
        autoencoder = coder.network
    elif change.vae:
        what = "adds to an autoencoder, and there is none"
        raise CheckpointInvalid(what, where=str(difix), hint="Give --vae DIR.")
    schedule = folder / "scheduler" / _SCHEDULE
    noise = (
        _noise(read_model_config(schedule.parent, _SCHEDULE))
        if schedule.is_file()
        else None
    )
    adapters = [(one.inside, 1.0) for one in read if one.inside is not None]
    adapters += [(read_lora(path), scale) for path, scale in loras]
    homes = homes_of(unet.network, autoencoder)
    files = [one.path for one in read] + ([] if difix is None else [difix])
    files += [adapter.path for adapter, _ in adapters if adapter.path not in files]
    return DiffusionCheckpoint(
        folder,
        unet.network,
        autoencoder,
        noise,
        _digest(files),
        added=tuple(merge(adapter, scale, homes) for adapter, scale in adapters),
        warnings=tuple(_text_left_out(one) for one, _ in adapters if one.text),
    )


@dataclass(frozen=True, slots=True)
class _Read(Generic[_Net]):
    """A network, the file of its weights, and the LoRA that they were saved with, if any."""

    network: _Net
    path: Path
    inside: Adapter | None


def _network(
    place: Path,
    network: Callable[[ModelConfig, Mapping[str, Any]], _Net],
    change: Mapping[str, Any],
    changed_by: Path | None,
) -> _Read[_Net]:
    config = read_model_config(place)
    path, state = _weights(place)
    plain, inside = fused(state | dict(change), changed_by or path)
    # Built without memory behind it: the file's tensors take the places of its own.
    try:
        with torch.device("meta"):
            made = network(config, plain)
    except (ValueError, ZeroDivisionError) as error:  # torch refuses a size
        raise CheckpointInvalid(
            f"makes no network: {error}", where=str(config.path)
        ) from error
    wanted = {name: tuple(value.shape) for name, value in made.state_dict().items()}
    read = require_tensors(changed_by or path, _renamed(plain, wanted), wanted)
    made.load_state_dict(read, strict=True, assign=True)
    return _Read(made.eval().requires_grad_(False), path, inside)


def _unet(config: ModelConfig, _: Mapping[str, Any]) -> UNet:
    return UNet(UNetOptions.of(config))


def _autoencoder(config: ModelConfig, state: Mapping[str, Any]) -> Autoencoder:
    skips = any(name.startswith(f"decoder.{SKIP}") for name in state)
    return Autoencoder(AutoencoderOptions.of(config, skips=skips))


def _require_latents(unet: UNet, autoencoder: Autoencoder, place: Path) -> None:
    latent = autoencoder.options.latent
    if (unet.options.inputs, unet.options.outputs) != (latent, latent):
        seen = f"{unet.options.inputs} to {unet.options.outputs} channels"
        what = f"takes {seen}, but the autoencoder's latents have {latent}"
        raise CheckpointInvalid(what, where=str(place / "config.json"))


def _text_left_out(adapter: Adapter) -> str:
    return (
        f"{adapter.path}: {len(adapter.text)} tensors are of the text encoder, which is not "
        "exported: --embeddings has to hold what it makes of the prompt with them"
    )


def _weights(place: Path) -> tuple[Path, dict[str, Any]]:
    plain = place / f"{_WEIGHTS}.safetensors"
    pickled = place / f"{_WEIGHTS}.bin"
    if plain.is_file() or not pickled.is_file():
        if (
            not plain.is_file()
            and (half := place / f"{_WEIGHTS}.fp16.safetensors").is_file()
        ):
            plain = half
        return plain, dict(read_safetensors(plain))
    return pickled, load_state(pickled, "the weights")


def _renamed(state: dict[str, Any], wanted: dict[str, tuple[int, ...]]) -> dict[str, Any]:
    """Give attention of old files its new names and shapes."""
    made = {}
    for name, value in state.items():
        *place, layer, kind = name.split(".") if name.count(".") else ("", "", name)
        new = ".".join([*place, _OLD[layer], kind]) if layer in _OLD else name
        if layer in _OLD and isinstance(value, Tensor) and value.ndim == 4:
            value = value[:, :, 0, 0]
        made[new if new in wanted else name] = value
    return made


def _noise(config: ModelConfig) -> Noise:
    """Return ᾱ of each timestep (Ho et al. 2020, section 2: the product of 1 − β)."""
    prediction = config.one_of("prediction_type", _PREDICTIONS, "epsilon")
    steps = config.integer("num_train_timesteps", 1000)
    kind = config.one_of(
        "beta_schedule", ("linear", "scaled_linear", "squaredcos_cap_v2"), "linear"
    )
    config.one_of("trained_betas", (None,), None)
    config.one_of("rescale_betas_zero_snr", (False,), False)
    low, high = config.number("beta_start", 0.0001), config.number("beta_end", 0.02)
    if not 0 <= low <= high < 1:
        raise config.wrong(
            "beta_start", f"is {low:g} and beta_end {high:g}, wanted 0 … 1 in order"
        )
    if kind == "linear":
        beta = torch.linspace(low, high, steps, dtype=torch.float64)
    elif kind == "scaled_linear":
        beta = torch.linspace(low**0.5, high**0.5, steps, dtype=torch.float64).square()
    else:  # Nichol and Dhariwal 2021, equation 17
        along = torch.arange(steps + 1, dtype=torch.float64) / steps
        left = torch.cos((along + 0.008) / 1.008 * math.pi / 2).square()
        beta = (1 - left[1:] / left[:-1]).clamp(max=_LARGEST_BETA)
    return Noise(torch.cumprod(1 - beta, dim=0), prediction)


def _digest(paths: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        with path.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
