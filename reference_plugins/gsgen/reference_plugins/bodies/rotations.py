"""Rotations: from axis-angles, and the one nearest to a blended matrix.

The latter is a quaternion, by the best of four formulas. Each component of a quaternion can be had from the matrix's diagonal and the others by division
(Shepperd 1978). Which component is divided by is chosen per Gaussian, by comparing; and as the
quaternion is normalised afterwards, nothing needs to be divided, and no sign be taken of what may
be zero.
"""

__all__ = ["nearest_rotation", "nearly_turned", "turned"]

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.tensors.planes import rotation_columns

# Below this squared angle, sin(a)/a is 1 and (1 − cos(a))/a² is ½ to the last bit of float32.
_SMALL_ANGLE = 1e-12
# Under the root of the published RodriguesModule; its axes are therefore not of unit length.
_UNDER_ROOT = 1e-5
# x, y and z as the matrices of their cross products.
_CROSS = (
    (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0),
    (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)


def turned(vector: Float[Tensor, "k j 3"]) -> Float[Tensor, "k j 3 3"]:
    """Turn rotation vectors into matrices: I + a K + b K², a = sin θ/θ and b = 2 (sin ½θ/θ)².

    By products of small matrices: of a few dozen joints each operator costs its launch alone.
    """
    square = (vector * vector).sum(dim=2, keepdim=True)
    angle = torch.sqrt(square.clamp(min=_SMALL_ANGLE))[:, :, :, None]
    cross = _cross(vector)
    half = torch.sin(0.5 * angle) / angle
    whole = torch.sin(angle) / angle * cross + (2 * half * half) * (cross @ cross)
    return torch.eye(3) + whole


def nearly_turned(vector: Float[Tensor, "k j 3"]) -> Float[Tensor, "k j 3 3"]:
    """Turn rotation vectors into matrices as GauHuman's RodriguesModule does.

    With θ = √(r² + 1e-5) and u = r/θ, which is not quite of unit length, it is
    cos θ I + (1 − cos θ) u uᵀ + sin θ [u]×.
    """
    square = (vector * vector).sum(dim=2, keepdim=True)
    angle = torch.sqrt(square + _UNDER_ROOT)
    axis = vector / angle
    cosine, sine = torch.cos(angle)[:, :, :, None], torch.sin(angle)[:, :, :, None]
    outer = axis[:, :, :, None] * axis[:, :, None, :]
    return cosine * torch.eye(3) + (1 - cosine) * outer + sine * _cross(axis)


def _cross(vector: Float[Tensor, "k j 3"]) -> Float[Tensor, "k j 3 3"]:
    return (vector @ torch.tensor(_CROSS)).reshape(*vector.shape[:2], 3, 3)


def nearest_rotation(
    matrix: Float[Tensor, "k 3 3 n"], stiff: Float[Tensor, "1 n"]
) -> Float[Tensor, "k 3 3 n"]:
    """Return rotations; the identity where ``stiff`` is 1.

    Args:
        matrix: Nearly rotations, such as means of several.
        stiff: 1 for what does not turn, 0 for the rest.
    """
    rows = [row.unbind(dim=1) for row in matrix.unbind(dim=1)]
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows
    squares = (1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz)
    wx, wy, wz = zy - yz, xz - zx, yx - xy
    bxy, bxz, byz = yx + xy, xz + zx, yz + zy
    candidates = [
        (squares[0], wx, wy, wz),
        (wx, squares[1], bxy, bxz),
        (wy, bxy, squares[2], byz),
        (wz, bxz, byz, squares[3]),
    ]
    stacked = [torch.stack(one, dim=1) for one in candidates]
    best, first = _better(squares[0], squares[1], stacked[0], stacked[1])
    other, second = _better(squares[2], squares[3], stacked[2], stacked[3])
    _, chosen = _better(best, other, first, second)
    w, x, y, z = chosen.unbind(dim=1)
    free = 1 - stiff
    columns = rotation_columns((w * free + stiff, x * free, y * free, z * free))
    return torch.stack([torch.stack(column, dim=1) for column in columns], dim=2)


def _better(
    a: Tensor, b: Tensor, quaternion_a: Tensor, quaternion_b: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the larger of two, and what belongs to it; the first where they are equal."""
    first = a >= b
    chosen = torch.where(first[:, None], quaternion_a, quaternion_b)
    return torch.maximum(a, b), chosen
