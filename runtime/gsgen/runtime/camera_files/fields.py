"""Read what a camera file says, and name the place where it says something else."""

__all__ = ["made_camera", "matrix", "number", "side", "text"]

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera


def number(made: Mapping[str, Any], name: str, where: str) -> float:
    """Return a finite number.

    Raises:
        ConfigInvalid: It is missing or none.
    """
    value = made.get(name)
    # An integer may be too large for a float.
    good = isinstance(value, int | float) and not isinstance(value, bool)
    if not good or not abs(value) <= 1e300:  # type: ignore[arg-type]
        raise ConfigInvalid(_seen(made, name, "a finite number"), where=where)
    return float(value)  # type: ignore[arg-type]


def side(made: Mapping[str, Any], name: str, where: str) -> int:
    """Return a number of pixels, which some writers give as 1920.0.

    Raises:
        ConfigInvalid: It is missing or no whole number.
    """
    value = number(made, name, where)
    if value != math.floor(value):
        raise ConfigInvalid(f"{name} is {value}, wanted whole pixels", where=where)
    return int(value)


def text(made: Mapping[str, Any], name: str, fallback: str) -> str:
    """Return a text, or what stands for it."""
    value = made.get(name)
    return fallback if value is None or isinstance(value, list | dict) else str(value)


def matrix(
    made: Mapping[str, Any], name: str, shape: tuple[int, ...], where: str
) -> Float[np.ndarray, "..."]:
    """Return an array of finite numbers.

    Raises:
        ConfigInvalid: It is missing, or of another shape.
    """
    wanted = "×".join(map(str, shape)) + " finite numbers"
    try:
        array = np.array(made[name], np.float64)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigInvalid(_seen(made, name, wanted), where=where) from error
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigInvalid(_seen(made, name, wanted), where=where)
    return array


def made_camera(where: str, **values: Any) -> Camera:
    """Return the camera of these attributes; what it refuses is said with its place.

    Raises:
        SceneInvalid: The numbers make no camera.
    """
    try:
        return Camera(**values)
    except SceneInvalid as error:
        raise SceneInvalid(
            error.message, where=f"{where}, {error.where}", hint=error.hint
        ) from error


def _seen(made: Mapping[str, Any], name: str, wanted: str) -> str:
    if name not in made:
        return f"lacks {name}: {wanted}"
    shown = repr(made[name])
    return f"{name} is {shown if len(shown) < 80 else shown[:77] + '…'}, wanted {wanted}"
