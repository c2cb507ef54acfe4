"""Measures the loss of a splat file format: source splats against the splats read back."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Float64

from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.quantities import SH_C0, sigmoid, unit
from gsgen.formats.shared.splats import Splats

__all__ = ["Difference", "differences"]

_CHUNK_ROWS = 1 << 16


@final
@dataclass(frozen=True, slots=True)
class Difference:
    """The error of one quantity, such as position, between two sets of splats.

    Attributes:
        name: The name of the quantity.
        unit: The unit of the numbers; empty for fractions of 1.
        largest: The largest difference.
        typical: The root mean square of the differences.
    """

    name: str
    unit: str
    largest: float
    typical: float


def differences(original: Splats, converted: Splats) -> tuple[Difference, ...]:
    """Compare two sets of splats row by row, in activated quantities such as opacity in [0, 1].

    Positions are in scene units, and their largest error includes that of reading the original;
    rotations in degrees, scales in percent (flat axes aside),
    opacities and constant colours from 0 to 1, harmonics unscaled up to the lower degree.
    """
    if len(original) != len(converted):
        raise ValueInvalid(
            f"the written file has {len(converted)} splats",
            where="after",
            expected=f"{len(original)} splats",
        )
    units = {"position": "units", "rotation": "°", "scale": "%"}
    names = ("position", "rotation", "scale", "opacity", "color", "harmonics")
    largest, squares, counts = (dict.fromkeys(names, 0.0) for _ in range(3))
    for name, difference in _field_differences(original, converted):
        largest[name] = max(largest[name], float(np.abs(difference).max(initial=0)))
        squares[name] += float(np.square(difference).sum())
        counts[name] += difference.size
    largest["position"] += original.rounding
    return tuple(
        Difference(
            name, units.get(name, ""), largest[name], math.sqrt(squares[name] / counts[name])
        )
        for name in names
        if counts[name]
    )


def _field_differences(
    original: Splats, converted: Splats
) -> Iterator[tuple[str, Float64[np.ndarray, "..."]]]:
    shift = np.subtract(original.origin, converted.origin)
    shared_count = min(original.sh.shape[1], converted.sh.shape[1])
    for start in range(0, len(original), _CHUNK_ROWS):
        part = slice(start, start + _CHUNK_ROWS)
        yield (
            "position",
            _field_difference(original.position[part], converted.position[part]) + shift,
        )
        yield "rotation", _degrees(original.rotation[part], converted.rotation[part])
        yield "scale", _percent_text(original.log_scale[part], converted.log_scale[part])
        opacities = (sigmoid(splats.logit_opacity[part]) for splats in (original, converted))
        yield "opacity", _field_difference(*opacities)
        yield "color", SH_C0 * _field_difference(original.sh[part, 0], converted.sh[part, 0])
        yield (
            "harmonics",
            _field_difference(
                original.sh[part, 1:shared_count], converted.sh[part, 1:shared_count]
            ),
        )


def _field_difference(
    original: Float[np.ndarray, "..."], converted: Float[np.ndarray, "..."]
) -> Float64[np.ndarray, "..."]:
    return np.asarray(original.astype(np.float64) - converted)


def _degrees(
    original: Float[np.ndarray, "n 4"], converted: Float[np.ndarray, "n 4"]
) -> Float64[np.ndarray, " n"]:
    """Return the angles in degrees between the rotations of two sets of quaternions."""
    p, q = (unit(quaternions).astype(np.float64) for quaternions in (original, converted))
    distances = [np.linalg.norm(p - sign * q, axis=1) for sign in (1, -1)]
    return np.asarray(np.degrees(4 * np.arcsin(np.minimum(np.minimum(*distances) / 2, 1))))


def _percent_text(
    original: Float[np.ndarray, "n 3"], converted: Float[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " m"]:
    is_finite = np.isfinite(original) & np.isfinite(converted)
    difference = converted[is_finite].astype(np.float64) - original[is_finite]
    with np.errstate(over="ignore"):
        return np.asarray(100 * np.expm1(difference))
