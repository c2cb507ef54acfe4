"""Reads checkpoints of image diffusion in the layout of diffusers.

A folder holds ``unet/`` and, if the U-Net works on latents, ``vae/``; ``scheduler/`` holds the
noise schedule. Each network is a ``config.json`` and ``diffusion_pytorch_model.safetensors`` (or
``.bin``). The folder of a U-Net alone is accepted, too. LoRA files and the changes of Difix are
merged into the weights.
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

from gsgen.reference_plugins.diffusion.autoencoder import SKIP_PREFIX, Autoencoder, autoencoder_of
from gsgen.reference_plugins.diffusion.lora import Adapter, merge, read_lora
from gsgen.reference_plugins.diffusion.lora_homes import layers_by_name
from gsgen.reference_plugins.diffusion.model_config import ModelConfig, read_model_config
from gsgen.reference_plugins.diffusion.unet import UNet, unet_of
from gsgen.reference_plugins.images.difix import Difix, read_difix, split_fused_lora
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.safetensors import read_safetensors
from gsgen.reference_plugins.loading.states import load_state, require_tensors

_Network = TypeVar("_Network", bound=nn.Module)

Prediction = Literal["epsilon", "v_prediction", "sample"]

_PREDICTION_TYPES = ("epsilon", "v_prediction", "sample")
_WEIGHTS_STEM = "diffusion_pytorch_model"
_SCHEDULE_FILE = "scheduler_config.json"
# Name of an attention layer in files from before 2023 → its name today.
_OLD_ATTENTION_NAMES = {"query": "to_q", "key": "to_k", "value": "to_v", "proj_attn": "to_out.0"}
_LARGEST_BETA = 0.999


@dataclass(frozen=True, slots=True)
class Noise:
    """The noise schedule that a diffusion network was trained with."""

    # ᾱ of each timestep: the remaining share of the image's variance, float64
    signal: Float[Tensor, " steps"]
    prediction: Prediction  # the quantity that the network predicts


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffusionCheckpoint:
    """The networks and the noise schedule of one diffusion checkpoint."""

    folder: Path  # the folder that was read
    unet: UNet  # the U-Net, its weights loaded
    autoencoder: Autoencoder | None  # the autoencoder; None if the U-Net works on pixels
    noise: Noise | None  # the noise schedule; None if the folder has none
    digest: str  # SHA-256 of the concatenated weight files
    added: tuple[str, ...] = ()  # descriptions of the LoRAs that were merged
    warnings: tuple[str, ...] = ()  # descriptions of tensors that have no effect

    @property
    def stride(self) -> int:
        """The number that width and height of an image must be multiples of."""
        pixels = 1 if self.autoencoder is None else self.autoencoder.options.stride
        return pixels * self.unet.options.stride

    @property
    def size(self) -> tuple[int, int] | None:
        """Height and width of the training images, if the checkpoint records them."""
        sample = self.unet.options.sample
        pixels = 1 if self.autoencoder is None else self.autoencoder.options.stride
        return None if sample is None else (pixels * sample[0], pixels * sample[1])

    def describe(self) -> str:
        """Describe a diffusion checkpoint in one line: networks, schedule and LoRAs."""
        options = self.unet.options
        count = sum(weight.numel() for weight in self.unet.parameters())
        parts = [f"U-Net of {count:,} weights, {len(options.channels)} levels"]
        parts += [f"conditioning of {options.context}"] if options.context else []
        if self.autoencoder is not None:
            pixels = self.autoencoder.options.stride
            skips = self.autoencoder.options.skips is not None
            autoencoder_network = "autoencoder" + " with skip connections" * skips
            parts.append(f"{autoencoder_network}, 1/{pixels} of the size")
        if self.noise is not None:
            steps = f"{len(self.noise.signal)} timesteps"
            parts.append(f"{steps}, predicts {self.noise.prediction}")
        parts += [f"LoRA {lora_text}" for lora_text in self.added]
        return f"{self.folder}: {', '.join(parts)}; sides are multiples of {self.stride}"


def read_diffusion(
    folder: Path,
    vae: Path | None = None,
    *,
    difix: Path | None = None,
    loras: Sequence[tuple[Path, float]] = (),
) -> DiffusionCheckpoint:
    """Read a diffusion checkpoint, and merge LoRAs into its weights.

    ``folder`` holds ``unet/``, or is a U-Net alone; ``vae`` is ``vae/`` in it by default. ``loras``
    are files with the factor of each.
    """
    change = Difix() if difix is None else read_difix(difix)
    unet_folder = folder / "unet" if (folder / "unet").is_dir() else folder
    unet: _LoadedNetwork[UNet] = _read_network(
        unet_folder, lambda config, _: unet_of(config), change.unet, difix
    )
    read: list[_LoadedNetwork[Any]] = [unet]
    autoencoder = None
    if vae is not None or (folder / "vae").is_dir():
        vae_folder = vae or folder / "vae"
        vae_folder = vae_folder / "vae" if (vae_folder / "vae").is_dir() else vae_folder
        autoencoder_network = _read_network(vae_folder, _autoencoder, change.vae, difix)
        _require_latents(unet.network, autoencoder_network.network, unet_folder)
        read.append(autoencoder_network)
        autoencoder = autoencoder_network.network
    elif change.vae:
        message = "changes an autoencoder, but the checkpoint has no vae/"
        raise CheckpointInvalid(message, where=str(difix), hint="Give --vae DIR.")
    schedule = folder / "scheduler" / _SCHEDULE_FILE
    noise = (
        _noise(read_model_config(schedule.parent, _SCHEDULE_FILE)) if schedule.is_file() else None
    )
    adapters = [(part.fused_adapter, 1.0) for part in read if part.fused_adapter is not None]
    adapters += [(read_lora(path), scale) for path, scale in loras]
    layers_of_name = layers_by_name(unet.network, autoencoder)
    files = [part.path for part in read] + ([] if difix is None else [difix])
    files += [adapter.path for adapter, _ in adapters if adapter.path not in files]
    return DiffusionCheckpoint(
        folder=folder,
        unet=unet.network,
        autoencoder=autoencoder,
        noise=noise,
        digest=_digest(files),
        added=tuple(merge(adapter, scale, layers_of_name) for adapter, scale in adapters),
        warnings=tuple(_text_encoder_warning(adapter) for adapter, _ in adapters if adapter.text),
    )


@dataclass(frozen=True, slots=True)
class _LoadedNetwork(Generic[_Network]):
    """A diffusion network read from a file, the file's path, and the LoRA in the file, if any."""

    network: _Network
    path: Path
    fused_adapter: Adapter | None


def _read_network(
    folder: Path,
    network: Callable[[ModelConfig, Mapping[str, Any]], _Network],
    change: Mapping[str, Any],
    changing_file: Path | None,
) -> _LoadedNetwork[_Network]:
    config = read_model_config(folder)
    path, state = _weights(folder)
    weights, fused_adapter = split_fused_lora(state | dict(change), changing_file or path)
    # Built on the meta device, without memory: the file's tensors replace its own.
    try:
        with torch.device("meta"):
            module = network(config, weights)
    except (ValueError, TypeError, ZeroDivisionError, NotImplementedError) as error:
        # Torch rejects a size, or diffusers an option.
        message = f"does not describe a valid network: {error}"
        raise CheckpointInvalid(message, where=str(config.path)) from error
    expected = {name: tuple(value.shape) for name, value in module.state_dict().items()}
    read = require_tensors(changing_file or path, _rename_attention(weights, expected), expected)
    module.load_state_dict(read, strict=True, assign=True)
    return _LoadedNetwork(module.eval().requires_grad_(False), path, fused_adapter)


def _autoencoder(config: ModelConfig, state: Mapping[str, Any]) -> Autoencoder:
    skips = any(name.startswith(f"decoder.{SKIP_PREFIX}") for name in state)
    return autoencoder_of(config, skips=skips)


def _require_latents(unet: UNet, autoencoder: Autoencoder, unet_folder: Path) -> None:
    latent = autoencoder.options.latent
    if (unet.options.inputs, unet.options.outputs) != (latent, latent):
        actual = f"{unet.options.inputs} to {unet.options.outputs} channels"
        message = f"takes {actual}, but the autoencoder's latents have {latent}"
        raise CheckpointInvalid(message, where=str(unet_folder / "config.json"))


def _text_encoder_warning(adapter: Adapter) -> str:
    return (
        f"{adapter.path}: {len(adapter.text)} tensors are of the text encoder, which is not "
        "exported: compute the --embeddings with them"
    )


def _weights(folder: Path) -> tuple[Path, dict[str, Any]]:
    path = folder / f"{_WEIGHTS_STEM}.safetensors"
    pickled_file = folder / f"{_WEIGHTS_STEM}.bin"
    if path.is_file() or not pickled_file.is_file():
        if (
            not path.is_file()
            and (half_file := folder / f"{_WEIGHTS_STEM}.fp16.safetensors").is_file()
        ):
            path = half_file
        return path, dict(read_safetensors(path))
    return pickled_file, load_state(pickled_file, "the weights")


def _rename_attention(
    state: dict[str, Any], expected: dict[str, tuple[int, ...]]
) -> dict[str, Any]:
    """Rename attention weights of old diffusers files to the current names and shapes."""
    renamed_tensors = {}
    for name, value in state.items():
        *parents, layer, kind = name.split(".") if name.count(".") else ("", "", name)
        new = (
            ".".join([*parents, _OLD_ATTENTION_NAMES[layer], kind])
            if layer in _OLD_ATTENTION_NAMES
            else name
        )
        if layer in _OLD_ATTENTION_NAMES and isinstance(value, Tensor) and value.ndim == 4:
            value = value[:, :, 0, 0]
        renamed_tensors[new if new in expected else name] = value
    return renamed_tensors


def _noise(config: ModelConfig) -> Noise:
    """Compute ᾱ of each timestep (Ho et al. 2020, section 2: the product of 1 − β)."""
    prediction = config.choice("prediction_type", _PREDICTION_TYPES, "epsilon")
    steps = config.integer("num_train_timesteps", 1000)
    kind = config.choice(
        "beta_schedule", ("linear", "scaled_linear", "squaredcos_cap_v2"), "linear"
    )
    config.choice("trained_betas", (None,), None)
    config.choice("rescale_betas_zero_snr", (False,), False)
    low, high = config.number("beta_start", 0.0001), config.number("beta_end", 0.02)
    if not 0 <= low <= high < 1:
        raise config.option_error(
            f"is {low:g} and beta_end {high:g}, expected 0 ≤ beta_start ≤ beta_end < 1",
            where="beta_start",
        )
    if kind == "linear":
        beta = torch.linspace(low, high, steps, dtype=torch.float64)
    elif kind == "scaled_linear":
        beta = torch.linspace(low**0.5, high**0.5, steps, dtype=torch.float64).square()
    else:  # Nichol and Dhariwal 2021, equation 17
        step_fractions = torch.arange(steps + 1, dtype=torch.float64) / steps
        signal = torch.cos((step_fractions + 0.008) / 1.008 * math.pi / 2).square()
        beta = (1 - signal[1:] / signal[:-1]).clamp(max=_LARGEST_BETA)
    return Noise(torch.cumprod(1 - beta, dim=0), prediction)


def _digest(paths: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        with path.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
