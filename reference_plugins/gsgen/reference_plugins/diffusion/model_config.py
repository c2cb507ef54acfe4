"""The options of a network, as a ``config.json`` of diffusers records them."""

__all__ = ["ModelConfig", "read_model_config"]

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import likely_folders

_MOST_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class ModelConfig:
    """The options of one network.

    Attributes:
        path: Where they were read.
        values: Option → what JSON holds.
    """

    path: Path
    values: Mapping[str, Any]

    def wrong(self, name: str, what: str) -> CheckpointInvalid:
        """Return the error of an option that cannot be honoured."""
        return CheckpointInvalid(f"{name} {what}", where=str(self.path))

    def one_of(self, name: str, values: Sequence[Any], default: Any = None) -> Any:
        """Return an option that must be one of ``values``."""
        value = self.values.get(name, default)
        if isinstance(value, list | dict) or value not in values:
            words = ", ".join(json.dumps(one) for one in values)
            raise self.wrong(name, f"is {json.dumps(value)}; supported: {words}")
        return value

    def integer(self, name: str, default: int, *, least: int = 1) -> int:
        """Return a whole number of at least ``least``."""
        value = self.values.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise self.wrong(name, f"is {value!r}, wanted a whole number from {least} on")
        return value

    def number(self, name: str, default: float) -> float:
        """Return a finite number."""
        value = self.values.get(name, default)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value):
            raise self.wrong(name, f"is {value!r}, wanted a number")
        return float(value)

    def flag(self, name: str, default: bool) -> bool:
        """Return a yes or no."""
        value = self.values.get(name, default)
        if not isinstance(value, bool):
            raise self.wrong(name, f"is {value!r}, wanted true or false")
        return value

    def integers(self, name: str) -> tuple[int, ...]:
        """Return a list of whole numbers above 0."""
        value = self.values.get(name)
        fits = (
            isinstance(value, list)
            and value
            and all(type(n) is int and n > 0 for n in value)
        )
        if not fits:
            raise self.wrong(name, f"is {value!r}, wanted a list of whole numbers")
        return tuple(value or ())

    def per_level(self, name: str, levels: int, default: int) -> tuple[int, ...]:
        """Return a whole number for each level; one in the file is that of all."""
        if not isinstance(self.values.get(name), list):
            return (self.integer(name, default),) * levels
        found = self.integers(name)
        if len(found) != levels:
            raise self.wrong(name, f"has {len(found)} numbers for {levels} levels")
        return found

    def kinds(self, name: str, known: Mapping[str, str], levels: int) -> tuple[str, ...]:
        """Return what ``known`` makes of the kind of each level's block."""
        found = self.values.get(name)
        if not isinstance(found, list) or len(found) != levels:
            raise self.wrong(name, f"is {found!r}, wanted a list of {levels} kinds")
        unknown = [kind for kind in found if not isinstance(kind, str) or kind not in known]
        if unknown:
            raise self.wrong(name, f"has {unknown[0]!r}; supported: {', '.join(known)}")
        return tuple(known[kind] for kind in found)

    def size(self, name: str) -> tuple[int, int] | None:
        """Return a height and a width; one number is both, and absent is None."""
        value = self.values.get(name)
        if value is None:
            return None
        if isinstance(value, list) and len(value) == 2:
            height, width = self.integers(name)
            return height, width
        side = self.integer(name, 1)
        return side, side


def read_model_config(folder: Path, name: str = "config.json") -> ModelConfig:
    """Read the options of a network.

    Args:
        folder: Where the file lies.
        name: Of the file.

    Raises:
        CheckpointInvalid: It is missing, or holds no JSON object.
    """
    path = folder / name
    if not path.is_file():
        near = likely_folders(
            folder, lambda one: (one / name).is_file() or (one / "unet" / name).is_file()
        )
        raise CheckpointInvalid("is missing: the options", where=str(path), hint=near)
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ValueError(f"has {path.stat().st_size:,} bytes")
        values = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path)) from error
    if not isinstance(values, dict):
        what = f"holds a {type(values).__name__}, wanted an object"
        raise CheckpointInvalid(what, where=str(path))
    return ModelConfig(path, values)
