"""Selects splats: in a box or sphere, by a value, or without isolated floaters."""

import itertools
import math
import operator
import re
from collections.abc import Callable
from typing import Final

import numpy as np
from jaxtyping import Float

from gsgen.formats.shared.errors import ValueInvalid, quoted
from gsgen.formats.shared.morton import grid_order
from gsgen.formats.shared.quantities import SH_C0, sigmoid
from gsgen.formats.shared.splats import Splats

_COMPARISONS: Final[dict[str, Callable[[np.ndarray, float], np.ndarray]]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}
_CONDITION_PATTERN: Final = re.compile(r"\s*(\w+)\s*(<=|>=|==|!=|<|>)\s*(\S+)\s*")

Quantity = Callable[[Splats], Float[np.ndarray, " n"]]


def _coordinate_quantity(axis: int) -> Quantity:
    def coordinate(splats: Splats) -> Float[np.ndarray, " n"]:
        offset = splats.position[:, axis]
        return offset + np.float64(splats.origin[axis]) if any(splats.origin) else offset

    return coordinate


def _scale(axis: int) -> Quantity:
    return lambda splats: np.exp(splats.log_scale[:, axis])


def _color(channel: int) -> Quantity:
    return lambda splats: np.asarray(0.5 + SH_C0 * splats.sh[:, 0, channel], np.float32)


FILTER_QUANTITIES: Final[dict[str, Quantity]] = {
    **{name: _coordinate_quantity(axis) for axis, name in enumerate("xyz")},
    **{f"scale_{axis}": _scale(axis) for axis in range(3)},
    "largest_scale": lambda splats: np.exp(splats.log_scale.max(axis=1)),
    "opacity": lambda splats: sigmoid(splats.logit_opacity),
    **{name: _color(channel) for channel, name in enumerate(("red", "green", "blue"))},
}
"""The quantities of a splat by name: scales are linear, opacity and colour from 0 to 1."""


def morton_ordered(splats: Splats) -> Splats:
    """Return ``splats`` sorted along a Morton curve, on a grid of 2²¹ cells along each axis."""
    position = splats.position.astype(np.float64)
    low, high = position.min(axis=0), position.max(axis=0)
    size = np.where(high > low, high - low, 1.0)
    return splats[grid_order(((position - low) / size * ((1 << 21) - 1)).astype(np.int64))]


def within_box(splats: Splats, corners: tuple[float, ...]) -> Splats:
    """Return the splats whose centres lie in a box: its low and its high corner, in the file's coordinates.

    Raises:
        ValueInvalid: A low coordinate is above the high one.
    """
    low, high = np.subtract(corners[:3], splats.origin), np.subtract(corners[3:], splats.origin)
    if (low > high).any():
        raise ValueInvalid(
            f"the corners are {corners}",
            where="box",
            expected="x, y, z of the low corner, then of a corner that is not lower",
        )
    inside_mask = (splats.position >= low) & (splats.position <= high)
    return splats[np.asarray(inside_mask.all(axis=1))]


def within_sphere(splats: Splats, sphere: tuple[float, ...]) -> Splats:
    """Return the splats whose centres lie in a sphere: its centre, in the file's coordinates, and radius."""
    offset = splats.position.astype(np.float64) - np.subtract(sphere[:3], splats.origin)
    inside_mask = np.square(offset).sum(axis=1) <= sphere[3] ** 2
    return splats[np.asarray(inside_mask)]


def where_value(splats: Splats, condition: str) -> Splats:
    """Return the splats that satisfy a condition such as ``opacity>=0.1``.

    Raises:
        ValueInvalid: The condition is not a name of ``FILTER_QUANTITIES``, a comparison and a number.
    """
    match = _CONDITION_PATTERN.fullmatch(condition)
    number = _number(match[3]) if match else None
    if match is None or number is None or match[1] not in FILTER_QUANTITIES:
        raise ValueInvalid(
            f"the condition is {quoted(condition)}",
            where="condition",
            expected=f"one of {', '.join(FILTER_QUANTITIES)}, then {' '.join(_COMPARISONS)}, then a number",
        )
    with np.errstate(over="ignore"):
        return splats[_COMPARISONS[match[2]](FILTER_QUANTITIES[match[1]](splats), number)]


def without_floaters(splats: Splats, size: float, neighbours: int) -> Splats:
    """Return the splats with at least ``neighbours`` other splats in the grid cells around them.

    Space is cut into cubic cells of side ``size``; the cells around are the 27 with the own one
    in the middle.

    Raises:
        ValueInvalid: ``size`` is not above 0, or so small that cells cannot be numbered.
    """
    if not 0 < size < math.inf:
        raise ValueInvalid(
            f"the cell size is {size:g}", where="floaters", expected="a cell size above 0"
        )
    position = splats.position.astype(np.float64)
    cell = np.floor((position - position.min(axis=0)) / size)
    if cell.max() >= (1 << 20):
        raise ValueInvalid(
            f"the cell size is {size:g} in a scene of {np.ptp(position, axis=0).max():g}",
            where="floaters",
            expected="cells of more than a millionth of the scene",
        )
    keys = (cell.astype(np.int64) + 1) @ np.array([1 << 42, 1 << 21, 1])
    occupied_cells, cell_index, counts = np.unique(keys, return_inverse=True, return_counts=True)
    total = np.zeros(len(occupied_cells), np.int64)
    for offset in itertools.product((-1, 0, 1), repeat=3):
        neighbour_cells = occupied_cells + np.array(offset) @ np.array([1 << 42, 1 << 21, 1])
        index = np.minimum(
            np.searchsorted(occupied_cells, neighbour_cells), len(occupied_cells) - 1
        )
        total += np.where(occupied_cells[index] == neighbour_cells, counts[index], 0)
    return splats[total[cell_index] - 1 >= neighbours]


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
