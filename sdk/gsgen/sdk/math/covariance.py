"""Covariances of Gaussians, as the upper triangle xx xy xz yy yz zz of the packed layout."""

__all__ = ["covariance_matrix", "covariance_upper", "rotate_covariance", "upper_triangle"]

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.layout import UPPER_TRIANGLE
from gsgen.sdk.math.rotations import matrix_entries, quaternion_to_matrix


def covariance_upper(
    scale: Float[Tensor, "n 3"], rotation: Float[Tensor, "n 4"]
) -> Float[Tensor, "n 6"]:
    """Return the upper triangles of the covariances R S Sᵀ Rᵀ (Kerbl et al. 2023, equation 6).

    Args:
        scale: Linear standard deviations along the local axes.
        rotation: Quaternions (w, x, y, z), normalised here.

    Written out entry by entry: six dot products of rows of R S instead of a batched 3×3 product,
    which costs more than twice the arithmetic.
    """
    rows = (quaternion_to_matrix(rotation) * scale[:, None, :]).unbind(dim=1)
    return torch.stack([(rows[a] * rows[b]).sum(dim=-1) for a, b in UPPER_TRIANGLE], dim=-1)


def covariance_matrix(upper_triangles: Float[Tensor, "n 6"]) -> Float[Tensor, "n 3 3"]:
    """Convert upper triangles xx xy xz yy yz zz to symmetric 3×3 matrices."""
    xx, xy, xz, yy, yz, zz = upper_triangles.unbind(dim=-1)
    entries = (xx, xy, xz, xy, yy, yz, xz, yz, zz)
    return torch.stack(entries, dim=-1).reshape(*upper_triangles.shape[:-1], 3, 3)


def upper_triangle(matrix: Float[Tensor, "n 3 3"]) -> Float[Tensor, "n 6"]:
    """Return the upper triangles xx xy xz yy yz zz of symmetric 3×3 matrices."""
    rows = matrix.unbind(dim=-2)
    return torch.stack([rows[a][..., b] for a, b in UPPER_TRIANGLE], dim=-1)


def rotate_covariance(
    upper_triangles: Float[Tensor, "n 6"], linear_map: Float[Tensor, "*n 3 3"]
) -> Float[Tensor, "n 6"]:
    """Return the upper triangle of T Σ Tᵀ: the covariance after a linear map.

    Args:
        upper_triangles: Upper triangles of Σ.
        linear_map: T, one for all rows or one per row; it need not be orthonormal.
    """
    xx, xy, xz, yy, yz, zz = upper_triangles.chunk(6, dim=1)
    rows = matrix_entries(linear_map)
    half = [
        (a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz)
        for a, b, c in rows
    ]
    products = [[x * y for x, y in zip(half[a], rows[b], strict=True)] for a, b in UPPER_TRIANGLE]
    return torch.cat([x + y + z for x, y, z in products], dim=1)
