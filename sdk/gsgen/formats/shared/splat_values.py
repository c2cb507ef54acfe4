"""Checks splats in memory: raises for arrays with values that cannot be drawn."""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32, Integer

from gsgen.formats.shared.splats import Splats
from gsgen.formats.shared.values import require_finite, require_rows

ALLOWED_INFINITIES = {"logit_opacity": (math.inf, -math.inf), "log_scale": (-math.inf,)}
"""The allowed infinities: opaque, invisible, and flat along an axis."""

SPLAT_ARRAY_NAMES = ("position", "rotation", "log_scale", "logit_opacity", "sh")
"""Names of the arrays of :class:`Splats`."""


def rows_of(
    splats: Splats, rows: slice | Integer[np.ndarray, " m"] | Bool[np.ndarray, " n"]
) -> Splats:
    """Return the splats at the given row indices, or where a mask is true."""
    return replace(splats, **{name: getattr(splats, name)[rows] for name in SPLAT_ARRAY_NAMES})


def require_drawable(splats: Splats) -> None:
    """Raise ValueInvalid if ``splats`` is empty or holds a value that cannot be drawn."""
    require_rows(len(splats), "the scene")
    for name in SPLAT_ARRAY_NAMES:
        table = getattr(splats, name).reshape(len(splats), -1)
        labels = [f"{name}[:, {column}]" for column in range(table.shape[1])]
        require_finite(table, labels, ALLOWED_INFINITIES.get(name, ()))


def linear_scale(splats: Splats) -> Float32[np.ndarray, "n 3"]:
    """Return the standard deviations of splats as float32."""
    with np.errstate(over="ignore"):
        scale = np.exp(splats.log_scale.astype(np.float64)).astype(np.float32)
    labels = [f"e^log_scale[:, {axis}]" for axis in range(3)]
    require_finite(scale, labels)
    return scale
