"""Refuse splats that cannot be drawn, in the words of the arrays in memory."""

import math

import numpy as np
from jaxtyping import Float32

from gsgen.formats.shared.splats import Splats
from gsgen.formats.shared.values import require_finite, require_rows

INFINITE = {"logit_opacity": (math.inf, -math.inf), "log_scale": (-math.inf,)}
"""Infinities with a meaning: opaque, invisible, and flat along an axis."""

_ARRAYS = ("position", "rotation", "log_scale", "logit_opacity", "sh")


def require_drawable(splats: Splats) -> None:
    """Raise ValueInvalid unless there are splats and all can be drawn."""
    require_rows(len(splats), "the scene")
    for name in _ARRAYS:
        table = getattr(splats, name).reshape(len(splats), -1)
        labels = [f"{name}[:, {column}]" for column in range(table.shape[1])]
        require_finite(table, labels, INFINITE.get(name, ()))


def linear_scale(splats: Splats) -> Float32[np.ndarray, "n 3"]:
    """Return standard deviations, from which every float32 logarithm can be had back.

    Raises:
        ValueInvalid: One is too large for a float32.
    """
    with np.errstate(over="ignore"):
        scale = np.exp(splats.log_scale.astype(np.float64)).astype(np.float32)
    labels = [f"e^log_scale[:, {axis}]" for axis in range(3)]
    require_finite(scale, labels)
    return scale
