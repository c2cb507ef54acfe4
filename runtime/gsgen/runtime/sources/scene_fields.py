"""Reads typed fields of a scene file by name; unknown fields are errors."""

__all__ = ["Fields", "fields_of", "read_sound_entry", "read_transform", "refuse"]

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NoReturn, TypeVar, cast, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.transforms import require_affine
from gsgen.runtime.sources.key_frames import EASINGS, KeyFrames, SceneSound

_MAX_NUMBER = 1e12
ChoiceText = TypeVar("ChoiceText", bound=str)
Alternative = TypeVar("Alternative", list[object], dict[str, object])


def refuse(message: str, where: str, hint: str = "") -> NoReturn:
    """Raise SceneInvalid for a fault of a scene file, with the location and a hint."""
    raise SceneInvalid(message, where=where, hint=hint)


def fields_of(document: Mapping[str, object], where: str) -> "Fields":
    """Return a reader of the fields of a scene file's outermost object."""
    return Fields(document, where, ": ")


@final
class Fields:
    """Reads the fields of one JSON object of a scene file."""

    def __init__(self, document: Mapping[str, object], where: str, separator: str = ".") -> None:
        self._document, self.where, self._separator = document, where, separator
        self._known_fields: list[str] = []

    def location(self, name: str) -> str:
        """Return the location of a scene file's field for error messages."""
        return f"{self.where}{self._separator}{name}"

    def refuse(self, name: str, message: str) -> NoReturn:
        """Raise SceneInvalid with the location of a scene file's field."""
        refuse(message, self.location(name))

    def has_field(self, name: str) -> bool:
        """Return whether a field of a scene file exists and is not null."""
        return self.unchecked_value(name) is not None

    def unchecked_value(self, name: str) -> object:
        """Read a field of a scene file without a check; None if the field is absent."""
        self._known_fields.append(name)
        return self._document.get(name)

    def text(self, name: str) -> str | None:
        """Read a text field of a scene file; None if the field is absent."""
        value = self.unchecked_value(name)
        if value is not None and not isinstance(value, str):
            self._raise_field_mismatch(name, "text")
        return value

    def text_or(self, name: str, kind: type[Alternative], title: str) -> str | Alternative | None:
        """Read a field of a scene file that is a text or of another given type."""
        value = self.unchecked_value(name)
        if value is not None and not isinstance(value, str | kind):
            self._raise_field_mismatch(name, f"text or {title}")
        return value

    def required_text(self, name: str) -> str:
        """Read a text field of a scene file that must be present and not empty."""
        value = self.unchecked_value(name)
        if not isinstance(value, str) or not value:
            self._raise_field_mismatch(name, "text")
        return str(value)

    def number(
        self, name: str, *, low: float = -_MAX_NUMBER, high: float = _MAX_NUMBER
    ) -> float | None:
        """Read a number field of a scene file, from ``low`` to ``high``."""
        value = self.unchecked_value(name)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            self._raise_field_mismatch(name, "a number")
        if not low <= value <= high:
            least = f"from {low:g}" if low > -_MAX_NUMBER else ""
            upper_limit = f"to {high:g}" if high < _MAX_NUMBER else ""
            self._raise_field_mismatch(
                name, " ".join(filter(None, ["a finite number", least, upper_limit]))
            )
        return float(value)

    def integer(self, name: str, *, low: int, high: int) -> int | None:
        """Read an integer field of a scene file, from ``low`` to ``high``."""
        value = self.unchecked_value(name)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            self._raise_field_mismatch(name, f"a whole number from {low} to {high}")
        return int(value)

    def side(self, name: str) -> int | None:
        """Read a field of a scene file that is a width or a height in pixels."""
        return self.integer(name, low=1, high=16_384)

    def choice(self, name: str, known: tuple[ChoiceText, ...]) -> ChoiceText | None:
        """Read a field of a scene file that must be one of the known words."""
        value = self.unchecked_value(name)
        if value is not None and value not in known:
            if not isinstance(value, str):
                self._raise_field_mismatch(name, " or ".join(known))
            raise UnknownName.among("word", value, known, self.location(name))
        return next((known_value for known_value in known if known_value == value), None)

    def array(self, name: str, *shapes: tuple[int, ...]) -> Float[np.ndarray, "..."] | None:
        """Read a field of a scene file with finite numbers in one of the given array shapes."""
        value = self.unchecked_value(name)
        if value is None:
            return None
        kinds = [
            "a number" if not shape else "×".join(map(str, shape)) + " numbers" for shape in shapes
        ]
        expected = " or ".join(kinds)
        try:
            array = np.array(value)
        except ValueError:  # rows of several lengths
            self._raise_field_mismatch(name, expected)
        if array.dtype.kind not in "if" or array.shape not in shapes:
            self._raise_field_mismatch(name, expected)
        if not (np.abs(array) <= _MAX_NUMBER).all():
            self._raise_field_mismatch(name, f"{expected} that are finite")
        return array.astype(np.float64)

    def values_or_keys(self, name: str) -> tuple[Mapping[str, np.ndarray], Mapping[str, KeyFrames]]:
        """Read an object whose values are numbers, lists of numbers, or key frames of them."""
        if not self.has_field(name):
            return {}, {}
        nested_fields = self.nested_fields(name)
        values, keys = {}, {}
        for key, value in nested_fields._document.items():
            if isinstance(value, dict):
                keys[key] = nested_fields.nested_fields(key).key_frames(_flat_numbers, "numbers")
            else:
                values[key] = self._values(f"{name}.{key}", value)
        return values, keys

    def key_frames(self, read: Callable[[object], list[float] | None], expected: str) -> KeyFrames:
        """Read the field ``keys`` of an object: key frames of numbers that ``read`` finds."""
        times: list[float] = []
        values: list[list[float]] = []
        easings: list[str] = []
        for part in self.parts("keys"):
            seconds = part.number("at", low=0)
            value = part.unchecked_value("value")
            numbers = None if value is None else read(value)
            easings.append(part.choice("easing", tuple(EASINGS)) or "linear")
            part.close()
            if seconds is None:
                part._raise_field_mismatch("at", "seconds from 0")
            if numbers is None:
                part._raise_field_mismatch("value", expected)
            if times and seconds <= times[-1]:
                part.refuse("at", "is not later than the one before")
            if values and len(numbers) != len(values[0]):
                part.refuse("value", "has another form than the first")
            times.append(seconds)
            values.append(numbers)
        self.close()
        if not times:
            self.refuse("keys", "has no key frame")
        return KeyFrames(tuple(times), np.array(values, np.float64), tuple(easings))

    def switch(self, name: str, *, default: bool = False) -> bool:
        """Read a field of a scene file that is true or false."""
        value = self.unchecked_value(name)
        if value is not None and not isinstance(value, bool):
            self._raise_field_mismatch(name, "true or false")
        return default if value is None else bool(value)

    def name_or_number(self, name: str) -> str | int | None:
        """Read a field of a scene file that is a text, or a whole number from 0."""
        value = self.unchecked_value(name)
        is_number = isinstance(value, int) and not isinstance(value, bool) and value >= 0
        if value is not None and not is_number and not (isinstance(value, str) and value):
            self._raise_field_mismatch(name, "text or a whole number from 0")
        return cast(str | int | None, value)

    def _values(self, name: str, value: object) -> np.ndarray:
        try:
            array = np.array(value)
        except ValueError:
            array = np.array(None)
        if array.dtype.kind not in "ifb":
            refuse(f"is {_shorten_value(value)}, expected numbers", self.location(name))
        return array

    def nested_fields(self, name: str) -> "Fields":
        """Return a reader of the fields of a nested JSON object in a scene file."""
        value = self.unchecked_value(name)
        if not isinstance(value, dict):
            self._raise_field_mismatch(name, "an object")
        return Fields(value, self.location(name))

    def parts(self, name: str) -> Iterator["Fields"]:
        """Yield a field reader for each object in a list; a string means an object's path."""
        entries = self.unchecked_value(name)
        if entries is not None and not isinstance(entries, list):
            self._raise_field_mismatch(name, "a list")
        for index, entry in enumerate(entries or []):
            where = f"{self.location(name)}[{index}]"
            document = {"path": entry} if isinstance(entry, str) else entry
            if not isinstance(document, dict):
                refuse(f"is {_shorten_value(entry)}, expected an object or a path", where)
            yield Fields(document, where)

    def close(self) -> None:
        """Raise if a field of a scene file's JSON object is unknown, that is, was never read."""
        for name in self._document:
            if name not in self._known_fields:
                raise UnknownName.among("field", name, set(self._known_fields), self.where)

    def _raise_field_mismatch(self, name: str, expected: str) -> NoReturn:
        if name not in self._document:
            refuse(f"is missing, expected {expected}", self.location(name))
        refuse(
            f"is {_shorten_value(self._document[name])}, expected {expected}", self.location(name)
        )


def _flat_numbers(value: object) -> list[float] | None:
    """Return all numbers of nested lists, in order; None of other values."""
    try:
        array = np.array(value)
    except ValueError:  # rows of several lengths
        return None
    is_numbers = array.dtype.kind in "ifb" and array.size and np.isfinite(array).all()
    return array.astype(np.float64).ravel().tolist() if is_numbers else None


def _shorten_value(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:59] + "…"


def read_transform(fields: Fields) -> Float[np.ndarray, "4 4"]:
    """Return the transform of an object in a scene file, by default translate × rotate × scale."""
    matrix = fields.array("transform", (4, 4))
    steps = [name for name in ("translate", "rotate", "scale") if fields.has_field(name)]
    if matrix is not None:
        if steps:
            fields.refuse(steps[0], "excludes `transform`: leave one of them out")
        require_affine(matrix, fields.location("transform"))
        return matrix
    transform = np.eye(4)
    scale = fields.array("scale", (), (3,))
    transform[:3, :3] = _rotation(fields) @ np.diag(
        np.broadcast_to(1.0 if scale is None else scale, 3)
    )
    translation = fields.array("translate", (3,))
    transform[:3, 3] = 0 if translation is None else translation
    require_affine(transform, fields.location("scale"))
    return transform


def _rotation(fields: Fields) -> Float[np.ndarray, "3 3"]:
    """Return the field ``rotate``: a quaternion w, x, y, z, or an axis and an angle in degrees."""
    if isinstance(fields.unchecked_value("rotate"), Mapping):
        nested_fields = fields.nested_fields("rotate")
        axis = nested_fields.array("axis", (3,))
        degrees = nested_fields.number("degrees")
        nested_fields.close()
        if axis is None or degrees is None or not np.linalg.norm(axis) > 0:
            fields.refuse("rotate", 'expected {"axis": [x, y, z], "degrees": d} or [w, x, y, z]')
        half_angle = np.radians(degrees) / 2
        rotation = np.append(np.cos(half_angle), np.sin(half_angle) * axis / np.linalg.norm(axis))
    else:
        quaternion = fields.array("rotate", (4,))
        rotation = np.array([1.0, 0, 0, 0]) if quaternion is None else quaternion
    if not np.linalg.norm(rotation) > 0:
        fields.refuse("rotate", "is the quaternion 0 0 0 0, expected one with a length")
    return np.asarray(rotation_matrix(rotation[None])[0])


def read_sound_entry(fields: Fields, folder: Path) -> SceneSound | None:
    """Read the field ``sound`` of a scene file in a folder; None if it is absent."""
    if not fields.has_field("sound"):
        return None
    nested_fields = fields.nested_fields("sound")
    captions = nested_fields.text("captions")
    sound = SceneSound(
        path=folder / nested_fields.required_text("path"),
        start=nested_fields.number("start") or 0.0,
        captions=None if captions is None else folder / captions,
    )
    nested_fields.close()
    return sound
