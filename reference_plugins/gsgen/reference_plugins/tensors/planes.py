"""Computes covariances from quaternions and scales, stored as one tensor per component.

Such a plane holds one component of all Gaussians, so no step slices quaternions, and each is one
kernel over contiguous memory. No tensor is larger than an input: a million Gaussians stay far
below the size limit of a binding, which a batch of 3×3 products would exceed.
"""

__all__ = ["covariance_planes", "planes_of", "rotation_columns", "stack_planes"]

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.layout import UPPER_TRIANGLE

_MIN_SQUARED_LENGTH = 1e-24


def rotation_columns(
    rotation: Sequence[Tensor], *, normalise: bool = True
) -> list[tuple[Tensor, Tensor, Tensor]]:
    """Return the three columns of the rotation matrix R(q), each as tensors of x, y and z.

    With ``normalise``, |q|² divides. Otherwise R is I − 2(…) of the quaternion as it is, as in the
    rasteriser of 3DGS.
    """
    factor: Tensor | float = math.sqrt(2.0)
    if normalise:
        w, x, y, z = rotation
        squared_length = w * w + x * x + y * y + z * z
        factor = torch.sqrt(2.0 / squared_length.clamp(min=_MIN_SQUARED_LENGTH))
    # With the factor √2, each product below is already the doubled one in R.
    w, x, y, z = (factor * part for part in rotation)
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    return [
        (1 - (yy + zz), xy + wz, xz - wy),
        (xy - wz, 1 - (xx + zz), yz + wx),
        (xz + wy, yz - wx, 1 - (xx + yy)),
    ]


def covariance_planes(
    scale: Sequence[Tensor], rotation: Sequence[Tensor], *, normalise: bool = True
) -> list[Tensor]:
    """Return the six components of the covariance R S Sᵀ Rᵀ (Kerbl et al. 2023, equation 6)."""
    columns = rotation_columns(rotation, normalise=normalise)
    axes = [[s * r for r in column] for s, column in zip(scale, columns, strict=True)]
    a, b, c = axes
    return [a[i] * a[j] + b[i] * b[j] + c[i] * c[j] for i, j in UPPER_TRIANGLE]


def planes_of(rows: Float[Tensor, "n k"]) -> list[Tensor]:
    """Split rows into one tensor [1, N] for each column."""
    transposed_rows = rows.transpose(0, 1)
    return [transposed_rows[i : i + 1] for i in range(rows.shape[1])]


def stack_planes(planes: Sequence[Tensor]) -> Tensor:
    """Join component tensors of M numbers each into rows [M, components]."""
    return torch.stack([plane.reshape(-1) for plane in planes], dim=0).transpose(0, 1)
