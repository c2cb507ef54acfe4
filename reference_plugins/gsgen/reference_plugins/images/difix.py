"""The file of Difix: what its training changed in the networks of sd-turbo.

``model.pkl`` is a dict that ``torch.save`` wrote: ``state_dict_unet`` holds the U-Net, as a whole
or what differs, and ``state_dict_vae`` what was added to the autoencoder, which is a LoRA on its
decoder and the convolutions of skip connections. The same file is written by img2img-turbo (Parmar
et al. 2024), where the U-Net has a LoRA, too.
"""

__all__ = ["Difix", "fused", "read_difix"]

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gsgen.reference_plugins.diffusion.lora import Adapter, paired
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.safetensors import is_safetensors
from gsgen.reference_plugins.loading.states import load_state

# α where a network was saved with its LoRA inside: files of such say none, and those who write
# them leave it as peft has it.
_ALPHA = 8.0
_BASE = ".base_layer."
_PARTS = ("state_dict_unet", "state_dict_vae")


@dataclass(frozen=True, slots=True)
class Difix:
    """What replaces or extends weights of two networks.

    Attributes:
        unet: Tensors of the U-Net by name, some of them of a LoRA.
        vae: The same of the autoencoder.
    """

    unet: Mapping[str, Any] = field(default_factory=dict)
    vae: Mapping[str, Any] = field(default_factory=dict)


def read_difix(path: Path) -> Difix:
    """Read a file of Difix.

    Raises:
        CheckpointInvalid: It cannot be read, or holds something else.
    """
    hint = "Give the model.pkl of Difix; a LoRA alone is --lora FILE."
    if is_safetensors(required_file(path, "what Difix trained")):
        raise CheckpointInvalid("is a safetensors file", where=str(path), hint=hint)
    state = load_state(path, "what Difix trained")
    if not all(isinstance(state.get(part), dict) for part in _PARTS):
        seen = ", ".join(map(str, list(state)[:4])) or "nothing"
        what = f"holds {seen}; wanted {' and '.join(_PARTS)}"
        raise CheckpointInvalid(what, where=str(path), hint=hint)
    unet, vae = (state[part] for part in _PARTS)
    return Difix(unet, vae)


def fused(state: Mapping[str, Any], path: Path) -> tuple[dict[str, Any], Adapter | None]:
    """Take a state dict apart that was saved with a LoRA inside, as peft wraps layers.

    Returns:
        Weights under the names of a network without it; and the LoRA, if there is one.
    """
    if not any(_BASE in name or ".lora_" in name for name in state):
        return dict(state), None
    pairs, rest = paired(state, path)
    plain = {name.replace(_BASE, "."): value for name, value in rest.items()}
    return plain, Adapter(path, pairs, alpha=_ALPHA) if pairs else None
