"""The transfer curve of sRGB (IEC 61966-2-1)."""

__all__ = ["linear_of_srgb", "srgb_of_linear"]

import numpy as np

from gsgen.contract._array_types import Float


def srgb_of_linear(color: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    """Encode linear light in [0, 1] as sRGB (IEC 61966-2-1)."""
    power_curve = (
        1.055 * np.power(color, 1 / 2.4, where=color > 0, out=np.zeros_like(color)) - 0.055
    )
    return np.asarray(np.where(color <= 0.0031308, 12.92 * color, power_curve))


def linear_of_srgb(color: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    """Decode sRGB in [0, 1] to linear light (IEC 61966-2-1)."""
    return np.asarray(np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4))
