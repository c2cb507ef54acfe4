"""Converts splats between coordinate systems whose axes differ in sign.

The signs of the harmonics follow from their parity: the function of degree l and order m is a
polynomial of z of the parity of l + m, times cos mφ for m ≥ 0 or sin |m|φ for m < 0.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float32

from gsgen.formats.shared.errors import ValueInvalid, quoted
from gsgen.formats.shared.splats import Splats

AxisSigns = tuple[int, int, int]
"""The factors of x, y and z, each 1 or −1."""

RDF_RUB: Final[AxisSigns] = (1, -1, -1)
"""Converts between x right, y down, z forward (PLY) and x right, y up, z back (SPZ)."""
RDF_LUF: Final[AxisSigns] = (-1, -1, 1)
"""Converts between x right, y down, z forward (PLY) and x left, y up, z forward (glTF)."""


def axis_signs(axes: str) -> AxisSigns:
    """Return the signs that convert PLY axes to ``axes``, such as ``RUB`` (right, up, back).

    Raises:
        ValueInvalid: ``axes`` is not R or L, then U or D, then F or B.
    """
    axis_letters = axes.upper()
    if len(axis_letters) != 3 or any(
        letter not in pair for letter, pair in zip(axis_letters, ("RL", "DU", "FB"), strict=True)
    ):
        raise ValueInvalid(
            quoted(axes), where="axes", expected="R or L, U or D, F or B, such as RUB or RDF"
        )
    x, y, z = (1 if letter in "RDF" else -1 for letter in axis_letters)
    return x, y, z


def flip(splats: Splats, signs: AxisSigns) -> Splats:
    """Return ``splats`` in a coordinate system whose axes are negated where ``signs`` are −1.

    A second call with the same ``signs`` undoes the first.
    """
    x, y, z = signs
    return replace(
        splats,
        position=_multiply_by_signs(splats.position, np.array(signs, np.float32)),
        rotation=_multiply_by_signs(
            splats.rotation, np.array([1, y * z, x * z, x * y], np.float32)
        ),
        sh=_multiply_by_signs(splats.sh, sh_signs(splats.degree, signs)[:, None]),
        origin=(x * splats.origin[0] + 0.0, y * splats.origin[1] + 0.0, z * splats.origin[2] + 0.0),
    )


def _multiply_by_signs(
    array: Float32[np.ndarray, "..."], signs: Float32[np.ndarray, "..."]
) -> Float32[np.ndarray, "..."]:
    product = array * signs
    product += 0  # turns −0 into 0
    return np.asarray(product)


def sh_signs(degree: int, signs: AxisSigns) -> Float32[np.ndarray, " k"]:
    """Return the sign change of each SH coefficient if x, y and z are multiplied by ``signs``."""
    bands_and_orders = [(band, m) for band in range(degree + 1) for m in range(-band, band + 1)]
    return np.array([_sh_sign(band, m, signs) for band, m in bands_and_orders], np.float32)


def _sh_sign(degree: int, order: int, signs: AxisSigns) -> int:
    x, y, z = signs
    sine = order < 0
    is_odd_in_x = (order % 2 == 1) != sine  # cos m(π − φ) = (−1)^m cos mφ, and −(−1)^m for sin
    is_odd_in_z = (degree + order) % 2 == 1
    return (x if is_odd_in_x else 1) * (y if sine else 1) * (z if is_odd_in_z else 1)
