"""Chooses the 256 codebook numbers that quantise the values in a SOG image."""

from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from gsgen.formats.sog.meta import CODES

_KNOTS: Final = 4096
_ROUNDS: Final = 300
_SAMPLES: Final = 1 << 22


def make_codebook(
    values: Float[np.ndarray, "..."], weights: Float[np.ndarray, " n"] | None = None
) -> Float32[np.ndarray, "256"]:
    """Return 256 ascending codebook numbers that quantise ``values`` with a small squared error.

    The start follows Panter & Dite 1951: the density of the numbers is the cube root of the
    density of the values. Lloyd's iterations (1957) then move each number to the mean of the
    values that are nearest to it. Of more than 4 million values, evenly spaced ones decide.

    Args:
        values: Finite numbers, at least one.
        weights: The weight of each value's error; all are equal if None.
    """
    flat = values.reshape(-1)
    if weights is None and len(flat) > _SAMPLES:
        ends = np.array([flat.min(), flat.max()])
        flat = np.concatenate([flat[:: -(-len(flat) // _SAMPLES)], ends])
    order = np.argsort(flat, kind="stable")
    ascending = flat[order].astype(np.float64)
    weight = np.ones(len(ascending)) if weights is None else weights[order].astype(np.float64)
    distinct = np.unique(ascending.astype(np.float32))
    if len(distinct) <= CODES:
        return np.concatenate([distinct, np.repeat(distinct[-1:], CODES - len(distinct))])
    total, moment = (np.append(0, np.cumsum(terms)) for terms in (weight, weight * ascending))
    book = _companded(ascending)
    for _ in range(_ROUNDS):
        inner = np.searchsorted(ascending, (book[1:] + book[:-1]) / 2)
        edges = np.concatenate([[0], inner, [len(ascending)]])
        cell_weight = np.diff(total[edges])
        means = np.diff(moment[edges]) / np.maximum(cell_weight, np.finfo(np.float64).tiny)
        moved = np.sort(np.where(cell_weight > 0, means, book))
        if np.array_equal(moved, book):
            break
        book = moved
    return book.astype(np.float32)


def codes(
    values: Float[np.ndarray, "..."], book: Float32[np.ndarray, "256"]
) -> UInt8[np.ndarray, "..."]:
    """Return for each value the index of the nearest codebook number."""
    middles = (book[1:].astype(np.float64) + book[:-1]) / 2
    return np.searchsorted(middles, values).astype(np.uint8)


def _companded(ascending: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "256"]:
    """Return an initial codebook for ``values``, spaced by the cube root of their density."""
    ranks = np.linspace(0, len(ascending) - 1, _KNOTS + 1).astype(np.int64)
    knots = ascending[ranks]
    measure = np.append(0, np.cumsum(np.diff(knots) ** (2 / 3)))
    share = (np.arange(CODES) + 0.5) / CODES
    return np.asarray(np.interp(share * measure[-1], measure, knots))
