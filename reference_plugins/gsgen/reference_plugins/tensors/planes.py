"""Covariances from components that lie in planes: one tensor for each of w, x, y, z, sx, sy, sz.

A network that writes all w first, then all x, … needs no slicing between numbers of one
quaternion, and each step below is one kernel over contiguous memory. No tensor is wider than its
inputs, so a million Gaussians stay far below the limit of one binding, where a batch of 3×3
products would not.
"""

__all__ = ["covariance_planes", "planes_of", "rotation_columns", "stacked"]

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

_TINY = 1e-24
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def rotation_columns(
    rotation: Sequence[Tensor], *, normalise: bool = True
) -> list[tuple[Tensor, Tensor, Tensor]]:
    """Return the columns of R(q), each as x, y and z, for q = (w, x, y, z).

    Args:
        rotation: Four tensors of one shape.
        normalise: Divide by |q|²; without, R is I − 2(…) as the rasteriser of 3DGS computes it
            from whatever quaternion it is given.
    """
    factor: Tensor | float = math.sqrt(2.0)
    if normalise:
        w, x, y, z = rotation
        square = w * w + x * x + y * y + z * z
        factor = torch.sqrt(2.0 / square.clamp(min=_TINY))
    # Products of these are what R holds twice; so no product has to be doubled.
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
    """Return xx, xy, xz, yy, yz, zz of R S Sᵀ Rᵀ (Kerbl et al. 2023, equation 6).

    Args:
        scale: Standard deviations along the three axes, of one shape.
        rotation: w, x, y, z, of the same shape.
        normalise: See :func:`rotation_columns`.
    """
    columns = rotation_columns(rotation, normalise=normalise)
    axes = [[s * r for r in column] for s, column in zip(scale, columns, strict=True)]
    a, b, c = axes
    return [a[i] * a[j] + b[i] * b[j] + c[i] * c[j] for i, j in _PAIRS]


def planes_of(rows: Float[Tensor, "n k"]) -> list[Tensor]:
    """Turn rows into k planes, [1, N] each."""
    turned = rows.transpose(0, 1)
    return [turned[i : i + 1] for i in range(rows.shape[1])]


def stacked(planes: Sequence[Tensor]) -> Tensor:
    """Turn planes of M numbers each into rows, [M, len(planes)]."""
    return torch.stack([plane.reshape(-1) for plane in planes], dim=0).transpose(0, 1)
