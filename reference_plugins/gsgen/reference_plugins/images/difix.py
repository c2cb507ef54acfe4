"""Reads the file of Difix: the weights that its training changed in the networks of sd-turbo.

``model.pkl`` is a dict saved by ``torch.save``: ``state_dict_unet`` holds the U-Net, or its changed
tensors, and ``state_dict_vae`` the additions to the autoencoder: a LoRA of its decoder and the
convolutions of skip connections. img2img-turbo (Parmar et al. 2024) writes the same file, where the
U-Net has a LoRA, too.
"""

__all__ = ["Difix", "read_difix", "split_fused_lora"]

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gsgen.reference_plugins.diffusion.lora import Adapter, split_pairs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.safetensors import is_safetensors
from gsgen.reference_plugins.loading.states import load_state

# α of a network that was saved with its LoRA inside: such files do not record it, and the tools
# that write them keep the default of peft.
_DIFIX_ALPHA = 8.0
_BASE_LAYER = ".base_layer."
_STATE_NAMES = ("state_dict_unet", "state_dict_vae")


@dataclass(frozen=True, slots=True)
class Difix:
    """Tensors of Difix that replace or extend the weights of U-Net and autoencoder."""

    # tensors of the U-Net by name, including those of a LoRA
    unet: Mapping[str, Any] = field(default_factory=dict)
    vae: Mapping[str, Any] = field(default_factory=dict)  # tensors of the autoencoder, likewise


def read_difix(path: Path) -> Difix:
    """Read a ``model.pkl`` of Difix."""
    hint = "Give the model.pkl of Difix; use --lora FILE for a LoRA alone."
    if is_safetensors(required_file(path, "the model.pkl of Difix")):
        raise CheckpointInvalid(
            "is a safetensors file, expected a pickle file", where=str(path), hint=hint
        )
    state = load_state(path, "the model.pkl of Difix")
    if not all(isinstance(state.get(part), dict) for part in _STATE_NAMES):
        actual = ", ".join(map(str, list(state)[:4])) or "no entries"
        message = f"holds {actual}; expected {' and '.join(_STATE_NAMES)}"
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    unet, vae = (state[part] for part in _STATE_NAMES)
    return Difix(unet, vae)


def split_fused_lora(state: Mapping[str, Any], path: Path) -> tuple[dict[str, Any], Adapter | None]:
    """Separate the LoRA from a state dict that was saved with the layers wrapped by peft.

    Returns the weights, named as without the LoRA, and the LoRA, if any.
    """
    if not any(_BASE_LAYER in name or ".lora_" in name for name in state):
        return dict(state), None
    pairs, unpaired_tensors = split_pairs(state, path)
    weights = {name.replace(_BASE_LAYER, "."): value for name, value in unpaired_tensors.items()}
    return weights, Adapter(path=path, pairs=pairs, alpha=_DIFIX_ALPHA) if pairs else None
