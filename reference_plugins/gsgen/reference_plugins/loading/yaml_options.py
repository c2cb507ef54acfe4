"""Reads the options of a training from a YAML file, by dotted names."""

__all__ = ["YamlOptions", "read_yaml_options"]

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from gsgen.reference_plugins.loading.errors import CheckpointInvalid

_MAX_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class YamlOptions:
    """Nested options of a YAML file, such as ``data.znear``."""

    path: Path
    values: Mapping[str, Any]

    def integer(self, name: str, default: int | None = None) -> int:
        """Return an option that is a whole number of at least 0."""
        value = self._value(name, default)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise self.fault(name, value, "a whole number")
        return value

    def integers(self, name: str, default: Sequence[int]) -> tuple[int, ...]:
        """Return an option that is a list of whole numbers."""
        value = self._value(name, list(default))
        if not isinstance(value, list) or not all(type(entry) is int for entry in value):
            raise self.fault(name, value, "a list of whole numbers")
        return tuple(value)

    def number(self, name: str, default: float | None = None) -> float:
        """Return an option that is a number."""
        value = self._value(name, default)
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self.fault(name, value, "a number")
        return float(value)

    def flag(self, name: str, *, default: bool) -> bool:
        """Return an option that is true or false."""
        value = self._value(name, default)
        if not isinstance(value, bool):
            raise self.fault(name, value, "true or false")
        return value

    def text(self, name: str, default: str | None = None) -> str:
        """Return an option that is a text; ``default`` where it is null, too."""
        value = self._value(name, default)
        value = default if value is None else value
        if not isinstance(value, str):
            raise self.fault(name, value, "a text")
        return value

    def fault(self, name: str, value: object, expected: str) -> CheckpointInvalid:
        """Return the error for an option with a value that is not supported."""
        return CheckpointInvalid(f"{name} is {value!r}, expected {expected}", where=str(self.path))

    def _value(self, name: str, default: object) -> Any:
        value: Any = self.values
        for part in name.split("."):
            if not isinstance(value, Mapping) or part not in value:
                return default
            value = value[part]
        return value


def read_yaml_options(folder: Path, names: Sequence[str], content: str) -> YamlOptions:
    """Read the first of some YAML files in a folder; ``content`` describes it in errors."""
    path = next((folder / name for name in names if (folder / name).is_file()), folder / names[0])
    if not path.is_file():
        hint = f"{content} belong there; or in {', '.join(names[1:])}."
        raise CheckpointInvalid("does not exist", where=str(path), hint=hint)
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise CheckpointInvalid(f"has more than {_MAX_BYTES:,} bytes", where=str(path))
        values = yaml.safe_load(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        line = str(error).splitlines()[0]
        raise CheckpointInvalid(f"cannot be read: {line}", where=str(path)) from error
    if not isinstance(values, Mapping):
        raise CheckpointInvalid("holds no options", where=str(path))
    return YamlOptions(path, values)
