"""Reads LoRA files, low-rank changes of a network's layers, and merges them into its weights.

W′ = W + scale · α/r · B A (Hu et al. 2021, "LoRA", section 4.1), where A has r rows. For a
convolution, A has its kernel size and B is 1×1.

Names of the tensors are those of peft (``layer.lora_A.weight``), of diffusers
(``layer.processor.to_q_lora.down.weight``, ``layer.lora.down.weight``) or of sd-scripts, called
kohya (``lora_unet_layer.lora_down.weight``, ``lora_unet_layer.alpha``).
"""

__all__ = ["Adapter", "LoraPair", "merge", "read_lora", "split_pairs"]

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.diffusion.model_config import read_model_config
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.safetensors import (
    is_safetensors,
    read_metadata,
    read_safetensors,
)
from gsgen.reference_plugins.loading.states import first_names, load_state

_FILE_NAMES = tuple(
    f"{name}.{kind}"
    for name in ("pytorch_lora_weights", "adapter_model")
    for kind in ("safetensors", "bin")
)
_CONFIG_FILE = "adapter_config.json"
_METADATA_KEY = "lora_adapter_metadata"
_PEFT_PREFIX = "base_model.model."
# The layer, then A (down) or B (up), with an adapter name in between.
_PAIR_NAME = re.compile(
    r"(?P<layer>.+?)\.(?:lora_(?P<peft>[AB])(?:\.(?P<adapter>\w+))?"
    r"|(?:lora_|lora\.|lora_linear_layer\.)(?P<plain>down|up))\.weight"
)
_PROCESSOR_NAME = re.compile(
    r"(?P<block>.+?)(?:\.processor)?\.(?P<what>to_q|to_k|to_v|to_out)_lora\."
    r"(?P<plain>down|up)\.weight"
)
_ALPHA_NAME = re.compile(r"(?P<layer>.+)\.alpha")
_TEXT_ENCODER_PREFIXES = ("text_encoder.", "text_encoder_2.", "lora_te_", "lora_te1_", "lora_te2_")
# Part of a tensor's name → the kind of adapter that it belongs to.
_UNSUPPORTED_ADAPTER_KINDS = {
    "dora_scale": "DoRA", "lora_magnitude_vector": "DoRA", "hada_": "LoHa", "lokr_": "LoKr",
    "lora_mid": "LoCon with a core", "oft_": "OFT",
}  # fmt: skip


@dataclass(slots=True)
class LoraPair:
    """The two low-rank matrices of a LoRA that change one layer, and their scale."""

    down: Tensor | None = None  # A, [r, i] or [r, i, h, w]
    up: Tensor | None = None  # B, [o, r] or [o, r, 1, 1]
    alpha: float | None = None  # α of the layer, if the file has it


@dataclass(frozen=True, slots=True, kw_only=True)
class Adapter:
    """The contents of a LoRA file: a pair of matrices for each changed layer."""

    path: Path
    pairs: Mapping[str, LoraPair]  # name of a layer in the file → its change
    # names of tensors of text encoders, which are not part of these networks
    text: tuple[str, ...] = ()
    alpha: float | None = None  # α of layers without their own; their rank by default
    alphas: Mapping[str, float] = field(default_factory=dict)  # suffix of a layer's name → α
    divides_by_root: bool = False  # α is divided by √r, not by r (Kalajdzievski 2023, "rsLoRA")

    def alpha_share(self, layer: str, pair: LoraPair, rank: int) -> float:
        """Return the factor α/r that scales a LoRA's change of a layer."""
        alpha = pair.alpha
        if alpha is None:
            matches = (
                value
                for layer_suffix, value in self.alphas.items()
                if f".{layer}".endswith(f".{layer_suffix}")
            )
            alpha = next(matches, rank if self.alpha is None else self.alpha)
        return alpha / (math.sqrt(rank) if self.divides_by_root else rank)


def read_lora(path: Path) -> Adapter:
    """Read a LoRA file, whose tensors have the names that its training tool uses.

    ``path`` is a safetensors file, a file of ``torch.save``, or the folder of either under the name
    that peft or diffusers gives it.
    """
    path = _adapter_file(path)
    uses_safetensors = is_safetensors(path)
    state = read_safetensors(path) if uses_safetensors else load_state(path, "a LoRA")
    pairs, unpaired_tensors = split_pairs(state, path)
    text = tuple(name for name in unpaired_tensors if name.startswith(_TEXT_ENCODER_PREFIXES))
    unknown = [name for name in unpaired_tensors if name not in text]
    if unknown:
        kinds = {
            kind
            for part, kind in _UNSUPPORTED_ADAPTER_KINDS.items()
            for name in unknown
            if part in name
        }
        raise CheckpointInvalid(
            f"{len(unknown)} tensors are not part of a LoRA: {first_names(unknown)}",
            where=str(path),
            hint=" ".join(f"{kind} is not supported." for kind in sorted(kinds)),
        )
    settings, where = _settings(path, read_metadata(path) if uses_safetensors else {})
    pattern = _checked_settings(settings, where)
    alpha = settings.get("lora_alpha")
    divides_by_root = settings.get("use_rslora") is True
    return Adapter(
        path=path,
        pairs=pairs,
        text=text,
        alpha=alpha,
        alphas=pattern,
        divides_by_root=divides_by_root,
    )


def _adapter_file(path: Path) -> Path:
    if not path.is_dir():
        return required_file(path, "a LoRA")
    for name in _FILE_NAMES:
        if (path / name).is_file():
            return path / name
    raise CheckpointInvalid(
        f"holds no LoRA: expected one of {', '.join(_FILE_NAMES)}", where=str(path)
    )


def split_pairs(state: Mapping[str, Any], path: Path) -> tuple[dict[str, LoraPair], dict[str, Any]]:
    """Separate the LoRA tensors of a state dict from all others.

    Returns layer → its change, and all other entries, those of text encoders included.
    """
    pairs: dict[str, LoraPair] = {}
    unpaired_tensors: dict[str, Any] = {}
    for name, value in state.items():
        location = None if name.startswith(_TEXT_ENCODER_PREFIXES) else _parse_name(name)
        if location is None:
            unpaired_tensors[name] = value
            continue
        layer, part = location
        if not isinstance(value, Tensor) or not torch.isfinite(value.double()).all():
            message = f"{name} is not a tensor, or holds NaN or infinity"
            raise CheckpointInvalid(message, where=str(path))
        pair = pairs.setdefault(layer, LoraPair())
        if getattr(pair, part) is not None:
            message = f"{name} is a second tensor of its kind for {layer}"
            hint = "Give a file that holds one adapter."
            raise CheckpointInvalid(message, where=str(path), hint=hint)
        if part == "alpha" and value.numel() != 1:
            message = f"{name} is {list(value.shape)}, expected one number"
            raise CheckpointInvalid(message, where=str(path))
        setattr(pair, part, value.item() if part == "alpha" else value)
    return pairs, unpaired_tensors


def _parse_name(name: str) -> tuple[str, str] | None:
    """Parse the name of a LoRA tensor into its layer and its kind: down, up or alpha."""
    unwrapped_name = name.replace(_PEFT_PREFIX, "")
    if match := _PROCESSOR_NAME.fullmatch(unwrapped_name):
        projection = "to_out.0" if match["what"] == "to_out" else match["what"]
        return f"{match['block']}.{projection}", match["plain"]
    if match := _PAIR_NAME.fullmatch(unwrapped_name):
        layer = match["layer"].replace(".processor.", ".")
        return layer, match["plain"] or {"A": "down", "B": "up"}[match["peft"]]
    if match := _ALPHA_NAME.fullmatch(unwrapped_name):
        return match["layer"], "alpha"
    return None


def _settings(path: Path, metadata: Mapping[str, str]) -> tuple[dict[str, Any], Path]:
    """Return the LoRA settings that peft saved, and their file: a config or the adapter file."""
    config_file = path.parent / _CONFIG_FILE
    if path.name.startswith("adapter_model") and config_file.is_file():
        return dict(read_model_config(path.parent, _CONFIG_FILE).values), config_file
    try:
        settings = json.loads(metadata.get(_METADATA_KEY, "{}"))
    except (ValueError, RecursionError) as error:
        message = f"{_METADATA_KEY} is not valid JSON: {error}"
        raise CheckpointInvalid(message, where=str(path)) from error
    if not isinstance(settings, dict):
        raise CheckpointInvalid(f"{_METADATA_KEY} is not a JSON object", where=str(path))
    # diffusers prefixes each setting with the network's name.
    return {name.removeprefix("unet."): value for name, value in settings.items()}, path


def _checked_settings(settings: Mapping[str, Any], where: Path) -> dict[str, float]:
    """Raise if a LoRA setting is not supported; return α for each suffix of a layer name."""
    for name, expected_value in {"use_dora": False, "fan_in_fan_out": False}.items():
        if settings.get(name, expected_value) not in (expected_value, None):
            message = f"{name} is {settings[name]!r}, supported: {expected_value!r}"
            raise CheckpointInvalid(message, where=str(where))
    if str(settings.get("peft_type", "LORA")).upper().rpartition(".")[2] != "LORA":
        message = f"peft_type is {settings['peft_type']!r}, supported: 'LORA'"
        raise CheckpointInvalid(message, where=str(where))
    pattern = settings.get("alpha_pattern") or {}
    ranks = pattern.values() if isinstance(pattern, dict) else [pattern]
    numbers = [settings.get("lora_alpha", 1), *ranks]
    if not all(type(number) in (int, float) and math.isfinite(number) for number in numbers):
        message = f"lora_alpha and alpha_pattern must hold finite numbers, but hold {numbers!r:.80}"
        raise CheckpointInvalid(message, where=str(where))
    for name in pattern:
        if not re.fullmatch(r"[\w.]+", name):  # peft interprets them as regular expressions
            message = f"alpha_pattern has {name!r}, supported: suffixes of layer names"
            raise CheckpointInvalid(message, where=str(where))
    return {name: float(value) for name, value in pattern.items()}


def merge(adapter: Adapter, scale: float, layers_of_unet: Mapping[str, nn.Module]) -> str:
    """Add a LoRA to the layers of networks in place, and return a summary.

    ``layers_of_unet`` are the layers by each of their names. The error lists the first tensors without a
    layer, a partner or a fitting shape; no layer is changed then.
    """
    mismatches = [
        f"{name} {mismatch}"
        for name, pair in adapter.pairs.items()
        if (mismatch := _lora_mismatch(pair, layers_of_unet.get(name)))
    ]
    if mismatches or not adapter.pairs:
        raise CheckpointInvalid(
            f"{len(mismatches)} of {len(adapter.pairs)} LoRA layers do not fit the networks: "
            f"{first_names(mismatches, '; ')}",
            where=str(adapter.path),
            hint="The LoRA may have been trained for another network.",
        )
    alpha_shares = set()
    for name, pair in adapter.pairs.items():
        layer, down_matrix = layers_of_unet[name], pair.down
        assert down_matrix is not None
        alpha_shares.add(alpha_share := adapter.alpha_share(name, pair, len(down_matrix)))
        weight = layer.weight
        assert isinstance(weight, Tensor)
        # A new tensor, because those of a file may share memory.
        merged_weight = (weight.double() + scale * alpha_share * _pair_product(pair, weight)).to(
            weight.dtype
        )
        layer.weight = nn.Parameter(merged_weight, requires_grad=False)
    words = f"{min(alpha_shares):g}" + f" to {max(alpha_shares):g}" * (len(alpha_shares) > 1)
    return f"{adapter.path.name} × {scale:g} in {len(adapter.pairs)} layers, α/r {words}"


def _lora_mismatch(pair: LoraPair, layer: nn.Module | None) -> str:
    """Return the reason why a LoRA change does not fit a layer; empty if it fits."""
    if layer is None:
        return "is not a layer of the networks"
    if pair.down is None or pair.up is None:
        return f"has no {'lora_A or down' if pair.down is None else 'lora_B or up'}"
    weight = layer.weight
    assert isinstance(weight, Tensor)
    down_matrix, up = _kernel(pair.down), _kernel(pair.up)
    has_fitting_shape = (
        down_matrix.ndim == up.ndim == 4
        and len(down_matrix) > 0
        and up.shape[1:] == (len(down_matrix), 1, 1)
    )
    if has_fitting_shape and (len(up), *down_matrix.shape[1:]) == _kernel(weight).shape:
        return ""
    actual = f"{list(pair.up.shape)} × {list(pair.down.shape)}"
    return f"has {actual}, which does not fit the weight {list(weight.shape)}"


def _pair_product(pair: LoraPair, weight: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Return the product B A of the LoRA matrices in float64, in the layer's weight shape."""
    assert pair.down is not None
    assert pair.up is not None
    down_matrix, up = _kernel(pair.down.double()), pair.up.double().flatten(1)
    return torch.einsum("or,rihw->oihw", up, down_matrix).reshape(weight.shape)


def _kernel(weight: Tensor) -> Tensor:
    return weight[:, :, None, None] if weight.ndim == 2 else weight
