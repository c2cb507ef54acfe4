"""The picture of one Gaussian by sampling: every sample is projected by the camera's exact model.

The density p of the samples in the image is the true one; a splat is a Gaussian that stands for it.
The picture of a density is ``opacity`` · 2π √|Σ| · p, with the covariance Σ of the samples: that of a
Gaussian density has the opacity at its peak, as splats have. Values below 1/255 are not drawn, and
none is above 0.99, as in the renderer. The pixel filter is a Gaussian of the camera's ``dilation``:
samples are moved by it, less the variance 1/12 of counting them by square pixels.
"""

from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri
from scipy.stats import qmc

from gsgen.runtime.scene.camera import Camera
from references.lenses import lens_pixels

_PIXEL_VARIANCE = 1 / 12
_DIMENSIONS = 5  # three of space, two of the pixel filter


@cache
def normal_samples(exponent: int) -> Float[np.ndarray, "n 5"]:
    """Return 2^exponent points of a Sobol sequence, distributed normally: far less noise than random ones."""
    return ndtri(qmc.Sobol(_DIMENSIONS, rng=np.random.default_rng(0)).random_base2(exponent))


def sampled_alpha(
    camera: Camera,
    center: Float[np.ndarray, "3"],
    covariance: Float[np.ndarray, "3 3"],
    opacity: float,
    *,
    exponent: int = 20,
) -> Float[np.ndarray, "h w"]:
    """Return the opacity picture of one Gaussian, whose numbers are in camera space."""
    samples = normal_samples(exponent)
    points = center + samples[:, :3] @ np.linalg.cholesky(covariance).T
    # Step 1: drop what no ray of the lens meets.
    rho, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    with np.errstate(divide="ignore"):
        radius = (
            np.arctan2(rho, z) if camera.kind == "fisheye" else np.where(z > 0, rho / z, np.inf)
        )
    is_seen = (
        np.ones(len(points), bool) if camera.kind == "orthographic" else radius < camera.ray_limit
    )
    # Step 2: project, and apply the pixel filter.
    pixels = lens_pixels(camera, points[is_seen])
    pixels += np.sqrt(camera.dilation - _PIXEL_VARIANCE) * samples[is_seen, 3:]
    spread = np.sqrt(np.linalg.det(np.cov(pixels.T) + _PIXEL_VARIANCE * np.eye(2)))
    # Step 3: count the samples of each pixel.
    columns, rows = np.floor(pixels).astype(int).T
    is_inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    index = rows[is_inside] * camera.width + columns[is_inside]
    counts = np.bincount(index, minlength=camera.width * camera.height)
    alpha = opacity * 2 * np.pi * spread * counts / len(samples)
    alpha = np.where(alpha < 1 / 255, 0, np.minimum(alpha, 0.99))
    return np.asarray(alpha.reshape(camera.height, camera.width))


def decibels_where_drawn(
    first: Float[np.ndarray, "h w"], second: Float[np.ndarray, "h w"]
) -> float:
    """Return the PSNR of two pictures in the smallest rectangle that holds what both show."""
    rows, columns = np.nonzero((first > 0) | (second > 0))
    if not len(rows):
        return float("nan")
    window = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    error = np.square(first[window] - second[window]).mean()
    return float(-10 * np.log10(max(error, 1e-20)))
