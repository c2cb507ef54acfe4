"""LoRA files: small changes to a network's layers, each a product of two thin matrices.

Hu et al. 2021, "LoRA". Names of the tensors are those of peft (``layer.lora_A.weight``), of
diffusers (``layer.processor.to_q_lora.down.weight``, ``layer.lora.down.weight``) or of sd-scripts,
called kohya (``lora_unet_layer.lora_down.weight``, ``lora_unet_layer.alpha``).
"""

__all__ = ["Adapter", "Pair", "paired", "read_lora"]

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gsgen.reference_plugins.diffusion.model_config import read_model_config
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.safetensors import (
    is_safetensors,
    read_metadata,
    read_safetensors,
)
from gsgen.reference_plugins.loading.states import first_names, load_state

_FILES = tuple(
    f"{name}.{kind}"
    for name in ("pytorch_lora_weights", "adapter_model")
    for kind in ("safetensors", "bin")
)
_CONFIG = "adapter_config.json"
_METADATA = "lora_adapter_metadata"
_WRAPPED = "base_model.model."
# Layer, and whether the tensor is A or B. What stands between is the name of the adapter.
_THIN = re.compile(
    r"(?P<layer>.+?)\.(?:lora_(?P<peft>[AB])(?:\.(?P<adapter>\w+))?"
    r"|(?:lora_|lora\.|lora_linear_layer\.)(?P<plain>down|up))\.weight"
)
_PROCESSOR = re.compile(
    r"(?P<block>.+?)(?:\.processor)?\.(?P<what>to_q|to_k|to_v|to_out)_lora\."
    r"(?P<plain>down|up)\.weight"
)
_ALPHA = re.compile(r"(?P<layer>.+)\.alpha")
_TEXT = ("text_encoder.", "text_encoder_2.", "lora_te_", "lora_te1_", "lora_te2_")
# What other kinds of small changes call their tensors.
_OTHER = {
    "dora_scale": "DoRA",
    "lora_magnitude_vector": "DoRA",
    "hada_": "LoHa",
    "lokr_": "LoKr",
    "lora_mid": "LoCon with a core",
    "oft_": "OFT",
}


@dataclass(slots=True)
class Pair:
    """The change of one layer.

    Attributes:
        down: A, [r, i] or [r, i, h, w].
        up: B, [o, r] or [o, r, 1, 1].
        alpha: α, where the file has one for the layer.
    """

    down: Tensor | None = None
    up: Tensor | None = None
    alpha: float | None = None


@dataclass(frozen=True, slots=True)
class Adapter:
    """A LoRA as its file says it.

    Attributes:
        path: The file.
        pairs: Layer, by the name that the file has for it → its change.
        text: Tensors of text encoders, which are no part of these networks.
        alpha: α of layers that have none of their own; their rank where absent.
        alphas: Ending of a layer's name → α.
        by_root: α is divided by √r, not by r (Kalajdzievski 2023, "rsLoRA").
    """

    path: Path
    pairs: Mapping[str, Pair]
    text: tuple[str, ...] = ()
    alpha: float | None = None
    alphas: Mapping[str, float] = field(default_factory=dict)
    by_root: bool = False

    def share(self, layer: str, pair: Pair, rank: int) -> float:
        """Return α/r of a layer."""
        alpha = pair.alpha
        if alpha is None:
            told = (
                value
                for ending, value in self.alphas.items()
                if f".{layer}".endswith(f".{ending}")
            )
            alpha = next(told, rank if self.alpha is None else self.alpha)
        return alpha / (math.sqrt(rank) if self.by_root else rank)


def read_lora(path: Path) -> Adapter:
    """Read a LoRA.

    Args:
        path: A safetensors file, one that ``torch.save`` wrote, or the folder of either under the
            name that peft or diffusers gives it.

    Raises:
        CheckpointInvalid: It cannot be read, or holds something else than a LoRA.
    """
    path = _found(path)
    safe = is_safetensors(path)
    state = read_safetensors(path) if safe else load_state(path, "a LoRA")
    pairs, rest = paired(state, path)
    text = tuple(name for name in rest if name.startswith(_TEXT))
    others = [name for name in rest if name not in text]
    if others:
        kinds = {kind for part, kind in _OTHER.items() for one in others if part in one}
        raise CheckpointInvalid(
            f"{len(others)} tensors are no part of a LoRA: {first_names(others)}",
            where=str(path),
            hint=" ".join(f"{kind} is not supported." for kind in sorted(kinds)),
        )
    settings, where = _settings(path, read_metadata(path) if safe else {})
    pattern = _checked_settings(settings, where)
    alpha = settings.get("lora_alpha")
    by_root = settings.get("use_rslora") is True
    return Adapter(path, pairs, text, alpha, pattern, by_root)


def _found(path: Path) -> Path:
    if not path.is_dir():
        return required_file(path, "a LoRA")
    for name in _FILES:
        if (path / name).is_file():
            return path / name
    raise CheckpointInvalid(f"holds none of {', '.join(_FILES)}", where=str(path))


def paired(state: Mapping[str, Any], path: Path) -> tuple[dict[str, Pair], dict[str, Any]]:
    """Sort the tensors of LoRA layers out of a state dict.

    Returns:
        Layer → its change; and all that is none of it, text encoders included.

    Raises:
        CheckpointInvalid: A tensor is none, not finite, or there are two for one place.
    """
    pairs: dict[str, Pair] = {}
    rest: dict[str, Any] = {}
    for name, value in state.items():
        place = None if name.startswith(_TEXT) else _place(name)
        if place is None:
            rest[name] = value
            continue
        layer, part = place
        if not isinstance(value, Tensor) or not torch.isfinite(value.double()).all():
            what = f"{name} is no tensor, or holds NaN or infinity"
            raise CheckpointInvalid(what, where=str(path))
        pair = pairs.setdefault(layer, Pair())
        if getattr(pair, part) is not None:
            what = f"{name} is the second of its kind for {layer}"
            raise CheckpointInvalid(what, where=str(path), hint="Give one adapter a file.")
        if part == "alpha" and value.numel() != 1:
            what = f"{name} is {list(value.shape)}, wanted one number"
            raise CheckpointInvalid(what, where=str(path))
        setattr(pair, part, value.item() if part == "alpha" else value)
    return pairs, rest


def _place(name: str) -> tuple[str, str] | None:
    """Return the layer that a tensor belongs to, and what it is there: down, up or alpha."""
    plain = name.replace(_WRAPPED, "")
    if found := _PROCESSOR.fullmatch(plain):
        what = "to_out.0" if found["what"] == "to_out" else found["what"]
        return f"{found['block']}.{what}", found["plain"]
    if found := _THIN.fullmatch(plain):
        layer = found["layer"].replace(".processor.", ".")
        return layer, found["plain"] or {"A": "down", "B": "up"}[found["peft"]]
    if found := _ALPHA.fullmatch(plain):
        return found["layer"], "alpha"
    return None


def _settings(path: Path, metadata: Mapping[str, str]) -> tuple[dict[str, Any], Path]:
    """Return what peft says of an adapter: in a file beside it, or in the file itself."""
    beside = path.parent / _CONFIG
    if path.name.startswith("adapter_model") and beside.is_file():
        return dict(read_model_config(path.parent, _CONFIG).values), beside
    try:
        told = json.loads(metadata.get(_METADATA, "{}"))
    except (ValueError, RecursionError) as error:
        what = f"{_METADATA} is no JSON: {error}"
        raise CheckpointInvalid(what, where=str(path)) from error
    if not isinstance(told, dict):
        raise CheckpointInvalid(f"{_METADATA} is no object", where=str(path))
    # diffusers writes the network's name before each.
    return {name.removeprefix("unet."): value for name, value in told.items()}, path


def _checked_settings(settings: Mapping[str, Any], where: Path) -> dict[str, float]:
    """Refuse what would make another network, and return α by ending of the layer's name."""
    for name, usual in {"use_dora": False, "fan_in_fan_out": False}.items():
        if settings.get(name, usual) not in (usual, None):
            what = f"{name} is {settings[name]!r}, supported: {usual!r}"
            raise CheckpointInvalid(what, where=str(where))
    if str(settings.get("peft_type", "LORA")).upper().rpartition(".")[2] != "LORA":
        what = f"peft_type is {settings['peft_type']!r}, supported: 'LORA'"
        raise CheckpointInvalid(what, where=str(where))
    pattern = settings.get("alpha_pattern") or {}
    numbers = [settings.get("lora_alpha", 1), *_values(pattern)]
    if not all(_is_number(one) for one in numbers):
        raise CheckpointInvalid(
            f"lora_alpha or alpha_pattern holds no numbers: {numbers!r:.80}",
            where=str(where),
        )
    for name in pattern:
        if not re.fullmatch(r"[\w.]+", name):  # peft takes them for regular expressions
            what = f"alpha_pattern has {name!r}, supported: endings of layers' names"
            raise CheckpointInvalid(what, where=str(where))
    return {name: float(value) for name, value in pattern.items()}


def _values(pattern: Any) -> Iterable[Any]:
    return pattern.values() if isinstance(pattern, dict) else [pattern]


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)
