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

_CHUNK = 1 << 16


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


def differences(before: Splats, after: Splats) -> tuple[Difference, ...]:
    """Compare two sets of splats row by row, in activated quantities such as opacity in [0, 1].

    Positions are in scene units, rotations in degrees, scales in percent (flat axes aside),
    opacities and constant colours from 0 to 1, harmonics unscaled up to the lower degree.
    """
    if len(before) != len(after):
        raise ValueInvalid(
            f"the written file has {len(after)} splats",
            where="after",
            expected=f"{len(before)} splats",
        )
    units = {"position": "units", "rotation": "°", "scale": "%"}
    names = ("position", "rotation", "scale", "opacity", "color", "harmonics")
    largest, squares, counts = (dict.fromkeys(names, 0.0) for _ in range(3))
    for name, difference in _field_differences(before, after):
        largest[name] = max(largest[name], float(np.abs(difference).max(initial=0)))
        squares[name] += float(np.square(difference).sum())
        counts[name] += difference.size
    return tuple(
        Difference(
            name, units.get(name, ""), largest[name], math.sqrt(squares[name] / counts[name])
        )
        for name in names
        if counts[name]
    )


def _field_differences(
    before: Splats, after: Splats
) -> Iterator[tuple[str, Float64[np.ndarray, "..."]]]:
    shared = min(before.sh.shape[1], after.sh.shape[1])
    for start in range(0, len(before), _CHUNK):
        part = slice(start, start + _CHUNK)
        yield "position", _minus(before.position[part], after.position[part])
        yield "rotation", _degrees(before.rotation[part], after.rotation[part])
        yield "scale", _percent(before.log_scale[part], after.log_scale[part])
        shares = (sigmoid(splats.logit_opacity[part]) for splats in (before, after))
        yield "opacity", _minus(*shares)
        yield "color", SH_C0 * _minus(before.sh[part, 0], after.sh[part, 0])
        yield "harmonics", _minus(before.sh[part, 1:shared], after.sh[part, 1:shared])


def _minus(
    before: Float[np.ndarray, "..."], after: Float[np.ndarray, "..."]
) -> Float64[np.ndarray, "..."]:
    return np.asarray(before.astype(np.float64) - after)


def _degrees(
    before: Float[np.ndarray, "n 4"], after: Float[np.ndarray, "n 4"]
) -> Float64[np.ndarray, " n"]:
    """Return the angles in degrees between the rotations of two sets of quaternions."""
    p, q = (unit(turns).astype(np.float64) for turns in (before, after))
    distances = [np.linalg.norm(p - sign * q, axis=1) for sign in (1, -1)]
    return np.asarray(np.degrees(4 * np.arcsin(np.minimum(np.minimum(*distances) / 2, 1))))


def _percent(
    before: Float[np.ndarray, "n 3"], after: Float[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " m"]:
    sized = np.isfinite(before) & np.isfinite(after)
    difference = after[sized].astype(np.float64) - before[sized]
    with np.errstate(over="ignore"):
        return np.asarray(100 * np.expm1(difference))
