"""Reads the options of a network from a ``config.json`` of diffusers."""

__all__ = ["ModelConfig", "arguments_of", "read_model_config"]

import inspect
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import likely_folders

_MAX_CONFIG_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class ModelConfig:
    """The options of one network, from a ``config.json`` of diffusers."""

    path: Path
    values: Mapping[str, Any]  # option → JSON value

    def option_error(self, problem: str, *, where: str) -> CheckpointInvalid:
        """Return an error about the neural network option ``where``; the caller raises it."""
        return CheckpointInvalid(f"{where} {problem}", where=str(self.path))

    def choice(self, name: str, values: Sequence[Any], default: Any = None) -> Any:
        """Return an option of a neural network that must be one of the supported values."""
        value = self.values.get(name, default)
        if isinstance(value, list | dict) or value not in values:
            words = ", ".join(json.dumps(allowed_value) for allowed_value in values)
            raise self.option_error(f"is {json.dumps(value)}; supported: {words}", where=name)
        return value

    def integer(self, name: str, default: int, *, least: int = 1) -> int:
        """Return an option of a neural network that must be an integer above a lower limit."""
        value = self.values.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise self.option_error(
                f"is {value!r}, expected an integer of at least {least}", where=name
            )
        return value

    def number(self, name: str, default: float) -> float:
        """Return an option of a neural network that must be a finite number."""
        value = self.values.get(name, default)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value):
            raise self.option_error(f"is {value!r}, expected a finite number", where=name)
        return float(value)

    def flag(self, name: str, *, default: bool) -> bool:
        """Return an option of a neural network that must be true or false."""
        value = self.values.get(name, default)
        if not isinstance(value, bool):
            raise self.option_error(f"is {value!r}, expected true or false", where=name)
        return value

    def integers(self, name: str) -> tuple[int, ...]:
        """Return an option of a neural network that must be a list of positive integers."""
        value = self.values.get(name)
        is_fitting_list = (
            isinstance(value, list) and value and all(type(n) is int and n > 0 for n in value)
        )
        if not is_fitting_list:
            raise self.option_error(
                f"is {value!r}, expected a list of positive integers", where=name
            )
        return tuple(value or ())

    def kinds(self, name: str, known_kinds: Mapping[str, str], levels: int) -> tuple[str, ...]:
        """Convert the block type of each network resolution level to the name that gsgen uses."""
        names = self.values.get(name)
        if not isinstance(names, list) or len(names) != levels:
            raise self.option_error(
                f"is {names!r}, expected a list of {levels} block types", where=name
            )
        unknown = [kind for kind in names if not isinstance(kind, str) or kind not in known_kinds]
        if unknown:
            raise self.option_error(
                f"has {unknown[0]!r}; supported: {', '.join(known_kinds)}", where=name
            )
        return tuple(known_kinds[kind] for kind in names)

    def size(self, name: str) -> tuple[int, int] | None:
        """Return a network's size option as height and width; a single number means both."""
        value = self.values.get(name)
        if value is None:
            return None
        if isinstance(value, list) and len(value) == 2:
            height, width = self.integers(name)
            return height, width
        image_side = self.integer(name, 1)
        return image_side, image_side


def read_model_config(folder: Path, name: str = "config.json") -> ModelConfig:
    """Read the options of a network from a ``config.json`` of diffusers."""
    path = folder / name
    if not path.is_file():
        nearby_folders = likely_folders(
            folder,
            lambda candidate: (candidate / name).is_file() or (candidate / "unet" / name).is_file(),
        )
        message = "is missing: expected the options of a network"
        raise CheckpointInvalid(message, where=str(path), hint=nearby_folders)
    try:
        if path.stat().st_size > _MAX_CONFIG_BYTES:
            raise ValueError(
                f"the file has {path.stat().st_size:,} bytes, expected at most {_MAX_CONFIG_BYTES:,}"
            )
        values = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path)) from error
    if not isinstance(values, dict):
        message = f"holds a {type(values).__name__}, expected an object"
        raise CheckpointInvalid(message, where=str(path))
    return ModelConfig(path, values)


def arguments_of(network: Callable[..., object], config: ModelConfig) -> dict[str, Any]:
    """Return the options of a ``config.json`` that are arguments of a network."""
    known_kinds = inspect.signature(network).parameters
    return {name: value for name, value in config.values.items() if name in known_kinds}
