"""Chooses the 256 codebook numbers that quantise the values in a SOG image."""

from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from gsgen.formats.sog.meta import CODEBOOK_SIZE

_KNOT_COUNT: Final = 4096
_MAX_LLOYD_ITERATIONS: Final = 300
_MAX_SAMPLES: Final = 1 << 22


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
    flat_values = values.reshape(-1)
    if weights is None and len(flat_values) > _MAX_SAMPLES:
        ends = np.array([flat_values.min(), flat_values.max()])
        flat_values = np.concatenate([flat_values[:: -(-len(flat_values) // _MAX_SAMPLES)], ends])
    order = np.argsort(flat_values, kind="stable")
    ascending_values = flat_values[order].astype(np.float64)
    weight = (
        np.ones(len(ascending_values)) if weights is None else weights[order].astype(np.float64)
    )
    distinct_values = np.unique(ascending_values.astype(np.float32))
    if len(distinct_values) <= CODEBOOK_SIZE:
        return np.concatenate(
            [distinct_values, np.repeat(distinct_values[-1:], CODEBOOK_SIZE - len(distinct_values))]
        )
    total, moment = (
        np.append(0, np.cumsum(terms)) for terms in (weight, weight * ascending_values)
    )
    codebook = _initial_codebook(ascending_values)
    for _ in range(_MAX_LLOYD_ITERATIONS):
        inner_edges = np.searchsorted(ascending_values, (codebook[1:] + codebook[:-1]) / 2)
        cluster_edges = np.concatenate([[0], inner_edges, [len(ascending_values)]])
        cell_weight = np.diff(total[cluster_edges])
        means = np.diff(moment[cluster_edges]) / np.maximum(cell_weight, np.finfo(np.float64).tiny)
        updated_codebook = np.sort(np.where(cell_weight > 0, means, codebook))
        if np.array_equal(updated_codebook, codebook):
            break
        codebook = updated_codebook
    return codebook.astype(np.float32)


def nearest_codes(
    values: Float[np.ndarray, "..."], codebook: Float32[np.ndarray, "256"]
) -> UInt8[np.ndarray, "..."]:
    """Return for each value the index of the nearest codebook number."""
    midpoints = (codebook[1:].astype(np.float64) + codebook[:-1]) / 2
    return np.searchsorted(midpoints, values).astype(np.uint8)


def _initial_codebook(ascending_values: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "256"]:
    """Return an initial codebook for ``values``, spaced by the cube root of their density."""
    ranks = np.linspace(0, len(ascending_values) - 1, _KNOT_COUNT + 1).astype(np.int64)
    codebook_knots = ascending_values[ranks]
    cumulative_density = np.append(0, np.cumsum(np.diff(codebook_knots) ** (2 / 3)))
    quantiles = (np.arange(CODEBOOK_SIZE) + 0.5) / CODEBOOK_SIZE
    return np.asarray(
        np.interp(quantiles * cumulative_density[-1], cumulative_density, codebook_knots)
    )
