"""Reads typed values from parsed JSON; each value is checked when it is read."""

__all__ = ["JsonDict", "JsonObject", "is_number", "parse_object", "shorten"]

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Never, TypeGuard, final

import numpy as np
from jaxtyping import Float64

from gsgen.tiles.errors import Fault, TilesetInvalid

JsonDict = dict[str, Any]
"""The members of a JSON object, before their types are checked."""

_MAX_SHOWN_CHARACTERS = 60
_MAX_MAGNITUDE = 1e300
MAX_JSON: Final = 128 << 20
"""How many bytes of JSON are parsed."""


def parse_object(data: bytes, location: str, *, fault: Fault = Fault.SCHEMA) -> "JsonObject":
    """Parse a JSON document whose root is an object.

    Raises:
        TilesetInvalid: It is not JSON, nests too deeply, or holds something else.
    """
    file = location.removesuffix(", ")  # that joins a file with the path of a member
    try:
        document = json.loads(data, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        reason = "it nests too deeply" if isinstance(error, RecursionError) else error
        raise TilesetInvalid(
            f"the text is not JSON ({reason})", location=file, expected="a JSON object", fault=fault
        ) from error
    if not isinstance(document, dict):
        raise TilesetInvalid(
            shorten(document), location=file, expected="a JSON object", fault=fault
        )
    return JsonObject(document, location, fault)


def _refuse_constant(name: str) -> Never:
    raise ValueError(f"{name} is not a JSON number")


def shorten(value: object) -> str:
    """Return a JSON value as one short line for error messages."""
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN_CHARACTERS else f"{text[: _MAX_SHOWN_CHARACTERS - 1]}…"


@final
@dataclass(frozen=True, slots=True)
class JsonObject:
    """A JSON object of a tileset, with its location in the file.

    Attributes:
        values: The members.
        location: The file and the JSON path, for errors.
        fault: What kind of fault a wrong member is.
    """

    values: JsonDict
    location: str
    fault: Fault = Fault.SCHEMA

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def refuse(self, key: str, expected: str) -> Never:
        """Raise TilesetInvalid for the JSON member ``key``, with its value and the expected one."""
        actual = shorten(self.values[key]) if key in self.values else "the member is missing"
        raise TilesetInvalid(actual, location=self.at(key), expected=expected, fault=self.fault)

    def at(self, key: str) -> str:
        """Return the location of a JSON member, for error messages."""
        separator = "" if self.location.endswith(", ") else "."
        return f"{self.location}{separator}{key}"

    def child(self, key: str) -> "JsonObject":
        """Return the required JSON object at ``key``."""
        value = self.values.get(key)
        if not isinstance(value, dict):
            self.refuse(key, "an object")
        return JsonObject(value, self.at(key), self.fault)

    def optional(self, key: str) -> "JsonObject | None":
        """Return the JSON object at ``key``, or None if the member is missing."""
        return self.child(key) if key in self.values else None

    def objects(self, key: str) -> Iterator["JsonObject"]:
        """Yield the objects of the JSON array at ``key``; nothing if the member is missing."""
        entries = self.values.get(key, [])
        if not isinstance(entries, list):
            self.refuse(key, "an array of objects")
        for index, entry in enumerate(entries):
            location = f"{self.at(key)}[{index}]"
            if not isinstance(entry, dict):
                raise TilesetInvalid(
                    shorten(entry), location=location, expected="an object", fault=self.fault
                )
            yield JsonObject(entry, location, self.fault)

    def text(self, key: str) -> str:
        """Return the required, nonempty JSON string at ``key``."""
        value = self.values.get(key)
        if not isinstance(value, str) or not value:
            self.refuse(key, "a string")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """Return the strings of the JSON array at ``key``; empty if the member is missing."""
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            self.refuse(key, "an array of strings")
        return tuple(value)

    def number(self, key: str, *, least: float = -_MAX_MAGNITUDE) -> float:
        """Return the finite JSON number at ``key``, which is at least ``least``."""
        value = self.values.get(key)
        if not is_number(value) or value < least:
            self.refuse(key, "a number" if least < 0 else f"a number, {least:g} or more")
        return float(value)

    def whole(self, key: str, *, least: int = 0, most: int = 2**53) -> int:
        """Return the whole JSON number at ``key``, from ``least`` to ``most``."""
        value = self.values.get(key)
        if not is_number(value) or value != int(value) or not least <= value <= most:
            self.refuse(key, f"a whole number from {least} to {most}")
        return int(value)

    def numbers(self, key: str, count: int) -> Float64[np.ndarray, " n"]:
        """Return the ``count`` finite numbers of the JSON array at ``key``."""
        value = self.values.get(key)
        if not isinstance(value, list) or len(value) != count or not all(map(is_number, value)):
            self.refuse(key, f"{count} finite numbers")
        return np.array(value, np.float64)


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a JSON value is a number that float64 holds."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < _MAX_MAGNITUDE and not math.isnan(value)
