"""Compares the stored splats of a file with those of the scene: likeness, and shift."""

__all__ = ["compare_stored"]

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.formats.shared.quantities import SH_C0, sigmoid
from gsgen.formats.shared.splats import Splats

_MEASURED_ROWS = 1024


def compare_stored(splats: Splats, stored: Splats) -> tuple[float, float]:
    """Return how like stored splats are to the splats they stand for, and how far they moved.

    The first is the worth of the file, 0 to 1. The second is the mean squared distance of the
    centres, in scene units².

    Each splat is seen along its shortest axis. Its similarity is the correlation of the two
    footprints, ∫ g h / √(∫ g² ∫ h²), times that of the two colours, 2 a·b / (a·a + b·b), where a
    and b hold α × the coefficients of the harmonics: their product is the integral of the colours
    over all directions. Splats are weighed by α × the area of the footprint. Of many splats, some
    1,000 at equal steps are measured.

    Args:
        splats: Of the scene; at least one.
        stored: The same splats in the same order, as a reader decodes them; of the same degree.
    """
    step = max(1, len(splats) // _MEASURED_ROWS)
    splats, stored = (rows[::step] for rows in (splats, stored))
    scale = np.exp(splats.log_scale.astype(np.float64))
    axes = rotation_matrix(splats.rotation.astype(np.float64))
    # 1. The two longer axes of each splat span the plane onto which both are projected.
    longer = np.argsort(scale, axis=1)[:, 1:]
    plane = np.take_along_axis(axes, longer[:, None, :], axis=2)
    own_scale = np.take_along_axis(scale, longer, axis=1)
    stored_axes = rotation_matrix(stored.rotation.astype(np.float64))
    spread = np.einsum("nik,nij->nkj", plane, stored_axes)
    spread = spread * np.exp(stored.log_scale.astype(np.float64))[:, None, :]
    stored_covariance = spread @ spread.transpose(0, 2, 1)
    shift = stored.position.astype(np.float64) - splats.position
    offset = np.einsum("nik,ni->nk", plane, shift)
    # 2. The correlation of two Gaussians in the plane, in closed form.
    a, b = (own_scale**2).T
    p, q, r = stored_covariance.reshape(-1, 4)[:, [0, 1, 3]].T
    u, v, (x, y) = a + p, b + r, offset.T
    determinant = np.maximum(u * v - q * q, np.finfo(float).tiny)
    squared_distance = (v * x * x - 2 * q * x * y + u * y * y) / determinant
    areas = np.sqrt(a * b) * np.sqrt(np.maximum(p * r - q * q, 0))
    overlap = 2 * np.sqrt(areas / determinant) * np.exp(-squared_distance / 2)
    # 3. Colours over all directions, times opacity.
    own, other = _radiance(splats), _radiance(stored)
    energy = (own**2 + other**2).sum(axis=1)
    likeness = np.where(
        energy > 0, 2 * (own * other).sum(axis=1) / np.where(energy > 0, energy, 1), 1
    )
    weight = sigmoid(splats.logit_opacity.astype(np.float64)) * np.sqrt(a * b)
    total = float(weight.sum())
    if not total:
        return 1.0, 0.0
    worth = float(np.clip((weight * overlap * likeness).sum() / total, 0, 1))
    return worth, float((weight * np.square(shift).sum(axis=1)).sum() / total)


def _radiance(splats: Splats) -> Float64[np.ndarray, "n c"]:
    """Return opacity × the harmonics' coefficients of each colour, with the constant of SH."""
    coefficients = splats.sh.astype(np.float64)
    coefficients[:, 0] += 0.5 / SH_C0
    opacity = sigmoid(splats.logit_opacity.astype(np.float64))
    return np.asarray(opacity[:, None] * coefficients.reshape(len(splats), -1))
