"""Reads typed fields of a camera file's JSON, with errors that name field and location."""

__all__ = ["camera_at", "matrix", "number", "pixel_count", "text"]

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera


def number(document: Mapping[str, Any], name: str, where: str) -> float:
    """Read a JSON field of a camera file that must be a finite number."""
    value = document.get(name)
    # An integer may be too large for a float.
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) <= 1e300:  # type: ignore[arg-type]
        raise ConfigInvalid(_mismatch(document, name, "a finite number"), where=where)
    return float(value)  # type: ignore[arg-type]


def pixel_count(document: Mapping[str, Any], name: str, where: str) -> int:
    """Read a JSON field of a camera file in whole pixels; some writers store 1920.0."""
    value = number(document, name, where)
    if value != math.floor(value):
        raise ConfigInvalid(f"{name} is {value}, expected whole pixels", where=where)
    return int(value)


def text(document: Mapping[str, Any], name: str, fallback: str) -> str:
    """Read a JSON field of a camera file as text; return ``fallback`` if the field is absent."""
    value = document.get(name)
    return fallback if value is None or isinstance(value, list | dict) else str(value)


def matrix(
    document: Mapping[str, Any], name: str, shape: tuple[int, ...], where: str
) -> Float[np.ndarray, "..."]:
    """Read a JSON field that must be an array of finite numbers of the given shape."""
    expected = "×".join(map(str, shape)) + " finite numbers"
    try:
        array = np.array(document[name], np.float64)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigInvalid(_mismatch(document, name, expected), where=where) from error
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigInvalid(_mismatch(document, name, expected), where=where)
    return array


def camera_at(where: str, **values: Any) -> Camera:
    """Build a camera from attributes; errors name the location in the camera file."""
    try:
        return Camera(**values)
    except SceneInvalid as error:
        raise SceneInvalid(
            error.message, where=f"{where}, {error.where}", hint=error.hint
        ) from error


def _mismatch(document: Mapping[str, Any], name: str, expected: str) -> str:
    if name not in document:
        return f"lacks {name}: expected {expected}"
    actual = repr(document[name])
    return f"{name} is {actual if len(actual) < 80 else actual[:77] + '…'}, expected {expected}"
