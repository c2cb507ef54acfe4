"""Merges Gaussians by matching moments, with conserved mass.

For members i of a cluster with centre μᵢ, covariance Σᵢ, opacity αᵢ and harmonics cᵢ::

    wᵢ = αᵢ · A(Σᵢ)                                     mass: opacity times surface
    A  = 4π ((aᵖbᵖ + aᵖcᵖ + bᵖcᵖ) / 3)^(1/p)            (a, b, c) = √eig Σᵢ, p = 1.6075
    μ* = Σ wᵢ μᵢ / Σ wᵢ
    Σ* = f² · Σ wᵢ (Σᵢ + κ (μᵢ − μ*)(μᵢ − μ*)ᵀ) / Σ wᵢ
    c* = Σ wᵢ cᵢ / Σ wᵢ
    α* = min(Σ wᵢ / A(Σ*), 0.999)

With κ = f = 1 these are the moments of Kerbl et al. 2024, "A Hierarchical 3D Gaussian
Representation for Real-Time Rendering of Very Large Datasets", section 4.1, weighted by opacity
times surface; the surface is K. Thomsen's formula of 2004. The opacity is cut at 0.999: a cluster
that is thicker than opaque hides what it would add, and growing Σ* until it fits blurs it.

κ and f are this project's. A cell that is filled evenly has a standard deviation of h/√12, and
Gaussians of that size at distance h leave gaps, through which one looks into a surface. κ = 2
fills them where they come from, between the members; f = 1.1 does the rest. Both conserve mass.
``tests/bench/tiles/bench_tiles.py`` measures the gain.
"""

__all__ = [
    "COVARIANCE_WIDENING_FACTOR",
    "MAX_OPACITY",
    "MAX_SPREAD_SIGMAS",
    "cell_scatter",
    "ellipsoids",
    "merge_clusters",
    "squared_shift",
]

from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64

from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.layout import UPPER_TRIANGLE
from gsgen.formats.merging.mixture import Mixture, surface_area
from gsgen.formats.shared.quantities import rotations

MAX_OPACITY: Final = 0.999
MAX_SPREAD_SIGMAS: Final = 2.0
"""κ: how much wider than its members' centres a merged Gaussian is, in variance."""
COVARIANCE_WIDENING_FACTOR: Final = 1.1
"""f: how much wider a merged Gaussian is at last, in standard deviations."""
_ROUNDED_DIGITS: Final = 6  # eigenvectors are rounded: their last bits differ between machines


def merge_clusters(
    mixture: Mixture,
    starts: Int64[np.ndarray, " m"],
    *,
    spread: float = MAX_SPREAD_SIGMAS,
    widen: float = COVARIANCE_WIDENING_FACTOR,
) -> Mixture:
    """Merge the Gaussians of each cluster, which are consecutive, into one by moment matching.

    A cluster without mass (nothing in it can be seen) vanishes; where all do, the first
    Gaussian stays, so that the result is never empty.

    Args:
        mixture: Sorted by code, at least one.
        starts: First row of each cluster, increasing from 0.
        spread: κ of the equations.
        widen: f of the equations.
    """
    mass = mixture.mass
    is_visible = mass > 0
    if not is_visible.any():
        return mixture.rows(np.arange(1))
    cluster = np.zeros(len(mixture), np.int64)
    cluster[starts[1:]] = 1
    cluster = np.cumsum(cluster)
    # 1. Leave out what cannot be seen, and number the clusters that remain.
    if not is_visible.all():
        mixture, mass, cluster = (mixture.rows(is_visible), mass[is_visible], cluster[is_visible])
    first = np.flatnonzero(np.diff(cluster, prepend=-1))
    sizes = np.diff(first, append=len(cluster))
    number = np.repeat(np.arange(len(first)), sizes)
    # 2. Weights that sum to 1 in each cluster.
    total = _group_sums(number, mass, len(first))
    weight = mass / total[number]
    # 3. Moments. Offsets from the first member keep digits far from the origin.
    origin = mixture.mean[first]
    offset = mixture.mean - origin[number]
    mean = _group_means(number, weight, offset, len(first))
    offset -= mean[number]
    scatter = np.stack([offset[:, i] * offset[:, j] for i, j in UPPER_TRIANGLE], axis=1)
    members = mixture.covariance + spread * scatter
    covariance = widen**2 * _group_means(number, weight, members, len(first))
    flat_sh = mixture.sh.reshape(len(mixture), -1)
    sh = _group_means(number, weight, flat_sh, len(first)).astype(np.float32)
    # 4. A single member stays as it is; the others are turned into ellipsoids.
    scale, rotation = mixture.scale[first], mixture.rotation[first]
    merged_mask = sizes > 1
    if merged_mask.any():
        scale[merged_mask], rotation[merged_mask] = ellipsoids(covariance[merged_mask])
    opacity = mixture.opacity[first]
    area = surface_area(scale[merged_mask])
    opacity[merged_mask] = np.minimum(total[merged_mask] / area, MAX_OPACITY)
    covariance[~merged_mask] = mixture.covariance[first[~merged_mask]]
    return Mixture(
        code=mixture.code[first],
        mean=origin + mean,
        covariance=covariance,
        scale=scale,
        rotation=rotation,
        opacity=opacity,
        sh=sh.reshape(len(first), *mixture.sh.shape[1:]),
    )


def squared_shift(mixture: Mixture, starts: Int64[np.ndarray, " m"]) -> float:
    """Return how far merging moves Gaussians: the mean of |μᵢ − μ*|² by mass, in scene units².

    Args:
        mixture: The Gaussians.
        starts: First row of each cluster, increasing from 0.
    """
    total = float(mixture.mass.sum())
    sizes = np.diff(starts, append=len(mixture))
    scatter = cell_scatter(mixture, np.repeat(np.arange(len(starts)), sizes))
    return float(scatter.sum()) / total if total else 0.0


def cell_scatter(mixture: Mixture, cell: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, " m"]:
    """Return each cluster's sum of mass × squared distance from the mean, over its splats."""
    mass = mixture.mass
    total = np.maximum(np.bincount(cell, mass), np.finfo(np.float64).tiny)
    result = np.zeros(len(total))
    for column in (mixture.mean - mixture.mean[0]).T:
        mean = np.bincount(cell, mass * column) / total
        result += np.bincount(cell, mass * np.square(column - mean[cell]))
    return result


def _group_means(
    number: Int64[np.ndarray, " n"],
    weight: Float64[np.ndarray, " n"],
    values: Float[np.ndarray, "n c"],
    clusters: int,
) -> Float64[np.ndarray, "m c"]:
    columns = [_group_sums(number, weight * column, clusters) for column in values.T]
    return np.stack(columns, axis=1)


def _group_sums(
    number: Int64[np.ndarray, " n"], values: Float64[np.ndarray, " n"], clusters: int
) -> Float64[np.ndarray, " m"]:
    """Sum the values of the Gaussians of each cluster, in float64 and in order."""
    return np.bincount(number, weights=values, minlength=clusters)


def ellipsoids(
    covariance: Float64[np.ndarray, "n 6"],
) -> tuple[Float64[np.ndarray, "n 3"], Float32[np.ndarray, "n 4"]]:
    """Return the standard deviations and rotations of covariances.

    Eigenvectors are rounded to 1e-6 and the largest component of the first two is positive: a
    matrix has the same rotation on every machine. A ball has the identity.

    Returns:
        Standard deviations [n, 3] and unit quaternions (w, x, y, z) [n, 4].
    """
    value, vector = np.linalg.eigh(symmetric(covariance))
    scale = np.sqrt(np.maximum(value, 0))
    vector = np.round(vector, _ROUNDED_DIGITS)
    largest = np.abs(vector).argmax(axis=1)[:, None, :]
    sign = np.where(np.take_along_axis(vector, largest, axis=1) < 0, -1.0, 1.0)
    vector *= sign
    vector[:, :, 2] *= np.where(np.linalg.det(vector) < 0, -1.0, 1.0)[:, None]
    rotation = rotations(vector)
    is_isotropic = value[:, 2] - value[:, 0] <= 10.0**-_ROUNDED_DIGITS * value[:, 2]
    rotation[is_isotropic] = np.array([1, 0, 0, 0], np.float32)
    return scale, rotation
