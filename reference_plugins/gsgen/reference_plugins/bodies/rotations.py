"""Computes rotation matrices from axis-angles, and the rotation nearest to a blended matrix.

The nearest rotation is found as a quaternion, by the best of four formulas (Shepperd 1978): one
component follows from the matrix's diagonal, the others by division through it. The largest
component is chosen per Gaussian, by comparison. The quaternion is normalised afterwards, so the
division is omitted, and no sign of a value near zero is needed.
"""

__all__ = ["gauhuman_rotation_matrices", "nearest_rotation", "rotation_matrices"]

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.tensors.planes import rotation_columns
from gsgen.sdk.math.rotations import SMALL_ANGLE

# Added under the root by the published RodriguesModule: its axes are not of unit length.
_MIN_SQUARED_ANGLE = 1e-5
# The cross product matrices of the axes x, y and z.
_CROSS_MATRICES = (
    (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0),
    (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)


def rotation_matrices(vector: Float[Tensor, "k j 3"]) -> Float[Tensor, "k j 3 3"]:
    """Convert rotation vectors to matrices by Rodrigues' formula, stable at small angles.

    It uses few operators on small matrices: for a few dozen joints, launches are the only cost.
    """
    squared_length = (vector * vector).sum(dim=2, keepdim=True)
    angle = torch.sqrt(squared_length.clamp(min=SMALL_ANGLE))[:, :, :, None]
    cross_matrices = _cross_product_matrices(vector)
    half_sine = torch.sin(0.5 * angle) / angle
    full_rotation = torch.sin(angle) / angle * cross_matrices + (2 * half_sine * half_sine) * (
        cross_matrices @ cross_matrices
    )
    return torch.eye(3) + full_rotation


def gauhuman_rotation_matrices(vector: Float[Tensor, "k j 3"]) -> Float[Tensor, "k j 3 3"]:
    """Convert rotation vectors to matrices as GauHuman's RodriguesModule does.

    With θ = √(r² + 1e-5) and u = r/θ, which is not exactly of unit length, the result is
    cos θ I + (1 − cos θ) u uᵀ + sin θ [u]×.
    """
    squared_length = (vector * vector).sum(dim=2, keepdim=True)
    angle = torch.sqrt(squared_length + _MIN_SQUARED_ANGLE)
    axis = vector / angle
    cosine, sine = torch.cos(angle)[:, :, :, None], torch.sin(angle)[:, :, :, None]
    outer_products = axis[:, :, :, None] * axis[:, :, None, :]
    return (
        cosine * torch.eye(3) + (1 - cosine) * outer_products + sine * _cross_product_matrices(axis)
    )


def _cross_product_matrices(vector: Float[Tensor, "k j 3"]) -> Float[Tensor, "k j 3 3"]:
    return (vector @ torch.tensor(_CROSS_MATRICES)).reshape(*vector.shape[:2], 3, 3)


def nearest_rotation(
    matrix: Float[Tensor, "k 3 3 n"], is_rigid: Float[Tensor, "1 n"]
) -> Float[Tensor, "k 3 3 n"]:
    """Return the rotation nearest to each matrix; the identity where ``is_rigid`` is 1."""
    rows = [row.unbind(dim=1) for row in matrix.unbind(dim=1)]
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows
    squares = (1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz)
    wx, wy, wz = zy - yz, xz - zx, yx - xy
    sum_xy, sum_xz, sum_yz = yx + xy, xz + zx, yz + zy
    candidates = [
        (squares[0], wx, wy, wz),
        (wx, squares[1], sum_xy, sum_xz),
        (wy, sum_xy, squares[2], sum_yz),
        (wz, sum_xz, sum_yz, squares[3]),
    ]
    candidate_rows = [torch.stack(components, dim=1) for components in candidates]
    best_norm, is_first_larger = _choose_larger_norm(
        squares[0], squares[1], candidate_rows[0], candidate_rows[1]
    )
    second_norm, second_best_quaternion = _choose_larger_norm(
        squares[2], squares[3], candidate_rows[2], candidate_rows[3]
    )
    _, quaternion = _choose_larger_norm(
        best_norm, second_norm, is_first_larger, second_best_quaternion
    )
    w, x, y, z = quaternion.unbind(dim=1)
    free_weight = 1 - is_rigid
    columns = rotation_columns(
        (w * free_weight + is_rigid, x * free_weight, y * free_weight, z * free_weight)
    )
    return torch.stack([torch.stack(column, dim=1) for column in columns], dim=2)


def _choose_larger_norm(
    a: Tensor, b: Tensor, quaternion_a: Tensor, quaternion_b: Tensor
) -> tuple[Tensor, Tensor]:
    """Return in each row the higher of two scores, and the quaternion that has this score."""
    is_first_larger = a >= b
    quaternion = torch.where(is_first_larger[:, None], quaternion_a, quaternion_b)
    return torch.maximum(a, b), quaternion
