"""Fits SH coefficients to colours seen from several cameras, by weighted least squares."""

__all__ = ["best_degree", "color_errors", "fit_sh"]

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32, Float64

from gsgen.contract.spec.spherical_harmonics import basis, coefficients

_CHUNK_ROWS = 1 << 14  # Gaussians at a time: normal equations of degree 3 take 2.5 KB each
_RIDGE_FACTOR = (
    1e-6  # of the mean diagonal, on degrees above 0: regularises rows that few cameras see
)
_DEGREE_TOLERANCE = (
    1.05  # a lower degree is chosen if its error is at most this factor above the best …
)
_INVISIBLE_ERROR = 1e-3  # … or this much above: a quarter of a step of 8-bit colour

Colors = Float[np.ndarray, "v n 3"]
Weights = Float[np.ndarray, "v n"]


def fit_sh(
    positions: Float[np.ndarray, "n 3"],
    eye_positions: Float[np.ndarray, "v 3"],
    colors: Colors,
    weights: Weights,
    degree: int,
) -> Float32[np.ndarray, "n k 3"]:
    """Fit SH coefficients to the colours that cameras see, by weighted least squares.

    They minimise Σ_v w_v² |0.5 + Y(d_v) · sh − color_v|² over the cameras v; Y is the SH basis.

    Args:
        positions: Centres of the Gaussians.
        eye_positions: Centres of the cameras; d_v points from a camera to the Gaussian.
        colors: Colours as each camera sees them.
        weights: Weight of each camera for each Gaussian, ≥ 0; 0 where it does not see it.
        degree: SH degree of the result, 0 to 3.
    """
    count = coefficients(degree)
    sh = np.empty((len(positions), count, 3), np.float32)
    for start in range(0, len(positions), _CHUNK_ROWS):
        part = slice(start, start + _CHUNK_ROWS)
        harmonics = basis(_directions(positions[part], eye_positions), degree)  # [v, n, k]
        weighted = np.swapaxes(harmonics * np.square(weights[:, part, None]), 0, 1)
        centered_colors = np.swapaxes(np.asarray(colors[:, part], np.float64), 0, 1) - 0.5
        normal = np.swapaxes(weighted, 1, 2) @ np.swapaxes(harmonics, 0, 1)
        target = np.swapaxes(weighted, 1, 2) @ centered_colors
        mean = np.trace(normal, axis1=1, axis2=2) / count
        ridge_penalty = (
            np.where(mean > 0, mean, 1)[:, None] * _RIDGE_FACTOR * (np.arange(count) > 0)
        )
        ridge_penalty[:, 0] += np.where(mean > 0, 0, 1)  # a row without weights becomes grey
        sh[part] = np.linalg.solve(normal + ridge_penalty[:, :, None] * np.eye(count), target)
    return sh


def color_errors(
    positions: Float[np.ndarray, "n 3"],
    eye_positions: Float[np.ndarray, "v 3"],
    colors: Colors,
    weights: Weights,
    sh: Float32[np.ndarray, "n k 3"],
) -> float:
    """Return the weighted RMS error of fitted SH colours, which are clamped to ≥ 0 as drawn.

    The cameras are held out of the fit; arguments are those of :func:`fit_sh`.
    """
    degree = int(np.sqrt(sh.shape[1])) - 1
    squared_error = total = 0.0
    for start in range(0, len(positions), _CHUNK_ROWS):
        part = slice(start, start + _CHUNK_ROWS)
        harmonics = basis(_directions(positions[part], eye_positions), degree)
        fitted_colors = np.maximum(0.5 + np.einsum("vnk,nkc->vnc", harmonics, sh[part]), 0)
        weight = np.square(np.asarray(weights[:, part], np.float64))
        target_colors = np.maximum(colors[:, part], 0)
        squared_error += float((weight[..., None] * np.square(fitted_colors - target_colors)).sum())
        total += 3 * float(weight.sum())
    return float(np.sqrt(squared_error / total)) if total > 0 else 0.0


def best_degree(errors: Sequence[float]) -> int:
    """Return the lowest SH degree whose held-out error is within 5 % or 0.001 of the best."""
    limit = max(_DEGREE_TOLERANCE * min(errors), min(errors) + _INVISIBLE_ERROR)
    return next(degree for degree, error in enumerate(errors) if error <= limit)


def _directions(
    positions: Float[np.ndarray, "n 3"], eye_positions: Float[np.ndarray, "v 3"]
) -> Float64[np.ndarray, "v n 3"]:
    rays = np.asarray(positions, np.float64)[None] - np.asarray(eye_positions, np.float64)[:, None]
    length = np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.asarray(rays / np.where(length > 0, length, 1))
