"""Computes the structural similarity (SSIM) of two pictures.

Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli 2004, "Image Quality Assessment: From Error
Visibility to Structural Similarity", equation 13, with the Gaussian window of that paper.
"""

__all__ = ["ssim"]

from typing import Final

import numpy as np
from jaxtyping import Float, Float64

_WINDOW_SIGMA: Final = 1.5
_WINDOW_RADIUS: Final = 5  # pixels: a window of 11
_LUMINANCE_CONSTANT, _CONTRAST_CONSTANT = 0.01**2, 0.03**2


def ssim(a: Float[np.ndarray, "h w c"], b: Float[np.ndarray, "h w c"]) -> float:
    """Return the mean structural similarity of two pictures, 1 if they are equal.

    Args:
        a: A picture, values in [0, 1].
        b: Another of the same shape.

    Returns:
        The mean over pixels and channels, less a margin where the window is cut.
    """
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    mean_a, mean_b = _blur_image(a), _blur_image(b)
    variance_a = _blur_image(a * a) - mean_a**2
    variance_b = _blur_image(b * b) - mean_b**2
    covariance = _blur_image(a * b) - mean_a * mean_b
    structure = (2 * covariance + _CONTRAST_CONSTANT) / (
        variance_a + variance_b + _CONTRAST_CONSTANT
    )
    luminance = (2 * mean_a * mean_b + _LUMINANCE_CONSTANT) / (
        mean_a**2 + mean_b**2 + _LUMINANCE_CONSTANT
    )
    return float((structure * luminance).mean())


def _blur_image(image: Float64[np.ndarray, "h w c"]) -> Float64[np.ndarray, "h w c"]:
    """Convolve a picture with the SSIM window, without borders."""
    steps = np.arange(-_WINDOW_RADIUS, _WINDOW_RADIUS + 1)
    window = np.exp(-0.5 * (steps / _WINDOW_SIGMA) ** 2)
    window /= window.sum()
    for axis in (0, 1):
        inner = image.shape[axis] - 2 * _WINDOW_RADIUS
        parts = (
            weight * np.take(image, range(shift, shift + inner), axis=axis)
            for shift, weight in enumerate(window)
        )
        image = np.asarray(sum(parts), np.float64)
    return image
