"""Splits numbers into bytes of a table: multiples of a step, in balanced digits of base 256."""

__all__ = ["constant_table", "digit_table", "digits_of"]

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64, UInt8

from gsgen.sdk.sequences.clip import DIGIT_ZERO, Table

_BASE: Final = 256


def digits_of(multiples: Int64[np.ndarray, " n"]) -> UInt8[np.ndarray, "d n"]:
    """Return the digits of whole numbers, the lowest first, as bytes with 128 for zero.

    Digits are between −128 and 127, so every number of up to seven digits has one spelling.
    """
    rest, digits = multiples, []
    while True:
        digit = (rest + DIGIT_ZERO) % _BASE - DIGIT_ZERO
        digits.append((digit + DIGIT_ZERO).astype(np.uint8))
        rest = (rest - digit) // _BASE
        if not rest.any():
            return np.stack(digits)


def digit_table(
    components: Sequence[Float[np.ndarray, "p n"]],
    weights: Float64[np.ndarray, "k r"],
    steps: Sequence[float],
) -> Table:
    """Return the table of components whose values are rounded to multiples of a step each.

    Args:
        components: Values of each component, plane by plane.
        weights: Weights of the components at each knot.
        steps: The step of each component.
    """
    rows: list[UInt8[np.ndarray, " pn"]] = []
    columns: list[Float32[np.ndarray, " k"]] = []
    for index, (component, step) in enumerate(zip(components, steps, strict=True)):
        multiples = np.rint(np.asarray(component, np.float64).reshape(-1) / step).astype(np.int64)
        for power, digits in enumerate(digits_of(multiples)):
            rows.append(digits)
            columns.append((weights[:, index] * step * _BASE**power).astype(np.float32))
    return Table(np.stack(rows), np.stack(columns, axis=1), len(components[0]))


def constant_table(values: Float[np.ndarray, "p n"], step: float) -> Table:
    """Return the table of values that do not change, rounded to multiples of a step."""
    return digit_table([values], np.ones((1, 1)), [step])
