"""Reads typed fields of a camera file, with errors that name field and location.

:class:`Fields` records which fields were read, so that every reader can name the others.
"""

__all__ = [
    "Fields",
    "camera_at",
    "coefficients",
    "distortion_at",
    "matrix",
    "number",
    "pixel_count",
    "require_object",
    "text",
    "unused_fields",
]

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.distortion import Distortion

_LISTED_FIELDS: Final = 24  # unused fields that a note lists


@final
class Fields(Mapping[str, Any]):
    """The fields of one object in a camera file, with a record of the fields that were read.

    Args:
        document: The object.
        shared: Fields that hold where this object has no field of that name.
    """

    def __init__(self, document: Mapping[str, Any], shared: "Fields | None" = None) -> None:
        self._document, self._shared_fields = document, shared
        self._read: set[str] = set()

    def __getitem__(self, name: str) -> Any:
        """Return a field, and record that it was read."""
        if name not in self._document and self._shared_fields is not None:
            return self._shared_fields[name]
        value = self._document[name]
        self._read.add(name)
        return value

    def __contains__(self, name: object) -> bool:
        """Return whether a field exists, without reading it."""
        return name in self._document or (
            self._shared_fields is not None and name in self._shared_fields
        )

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the object's own fields."""
        return iter(self._document)

    def __len__(self) -> int:
        """Return the number of the object's own fields."""
        return len(self._document)

    @property
    def read_names(self) -> frozenset[str]:
        """The names of the object's own fields that were read."""
        return frozenset(self._read)


def unused_fields(path: str, objects: Iterable[Fields]) -> tuple[str, ...]:
    """Return a note on the fields that no object of a camera file was asked for; empty if none."""
    declared: dict[str, None] = {}
    read: set[str] = set()
    for fields in objects:
        declared.update(dict.fromkeys(fields))
        read |= fields.read_names
    names = [str(name)[:60] for name in declared if name not in read]
    if not names:
        return ()
    rest = f" and {len(names) - _LISTED_FIELDS} more" if len(names) > _LISTED_FIELDS else ""
    return (f"{path}: not used: {', '.join(names[:_LISTED_FIELDS])}{rest}",)


def require_object(document: object, where: str) -> dict[str, Any]:
    """Raise if a JSON value of a camera file is not an object."""
    if not isinstance(document, dict):
        raise ConfigInvalid(
            f"the JSON value is a {type(document).__name__}, expected an object", where=where
        )
    return document


def number(document: Mapping[str, Any], name: str, where: str) -> float:
    """Read a JSON field of a camera file that must be a finite number."""
    value = document.get(name)
    # An integer may be too large for a float.
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) <= 1e300:  # type: ignore[arg-type]
        raise ConfigInvalid(_field_mismatch_text(document, name, "a finite number"), where=where)
    return float(value)  # type: ignore[arg-type]


def coefficients(document: Mapping[str, Any], names: Iterable[str], where: str) -> dict[str, float]:
    """Read JSON fields of a camera file that are finite numbers, or null; absent ones are left out."""
    return {name: number(document, name, where) for name in names if document.get(name) is not None}


def pixel_count(document: Mapping[str, Any], name: str, where: str) -> int:
    """Read a JSON field of a camera file in whole pixels; some writers store 1920.0."""
    value = number(document, name, where)
    if value != math.floor(value):
        raise ConfigInvalid(f"{name} is {value}, expected whole pixels", where=where)
    return int(value)


def text(document: Mapping[str, Any], name: str, default_text: str) -> str:
    """Read a JSON field of a camera file as text; return ``default_text`` if the field is absent."""
    value = document.get(name)
    return default_text if value is None or isinstance(value, list | dict) else str(value)


def matrix(
    document: Mapping[str, Any], name: str, shape: tuple[int, ...], where: str
) -> Float[np.ndarray, "..."]:
    """Read a JSON field that must be an array of finite numbers of the given shape."""
    expected = "×".join(map(str, shape)) + " finite numbers"
    try:
        array = np.array(document[name], np.float64)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigInvalid(_field_mismatch_text(document, name, expected), where=where) from error
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigInvalid(_field_mismatch_text(document, name, expected), where=where)
    return array


def camera_at(where: str, **values: Any) -> Camera:
    """Build a camera from attributes; errors name the location in the camera file."""
    try:
        return Camera(**values)
    except SceneInvalid as error:
        raise SceneInvalid(
            error.message, where=f"{where}, {error.where}", hint=error.hint
        ) from error


def distortion_at(
    where: str, values: Mapping[str, float], *, is_rational: bool = False
) -> Distortion:
    """Build a lens distortion by :meth:`Distortion.of`; errors name the location in the file."""
    try:
        return Distortion.of(values, is_rational=is_rational)
    except SceneInvalid as error:
        raise SceneInvalid(
            error.message, where=f"{where}, {error.where}", hint=error.hint
        ) from error


def _field_mismatch_text(document: Mapping[str, Any], name: str, expected: str) -> str:
    if name not in document:
        return f"lacks {name}: expected {expected}"
    actual = repr(document[name])
    return f"{name} is {actual if len(actual) < 80 else actual[:77] + '…'}, expected {expected}"
