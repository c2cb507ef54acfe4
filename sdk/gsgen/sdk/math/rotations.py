"""Torch functions for unit vectors, quaternions and rotation matrices."""

__all__ = [
    "SMALL_ANGLE",
    "axis_angle_to_matrix",
    "matrix_entries",
    "matrix_to_quaternion",
    "quaternion_multiply",
    "quaternion_to_matrix",
    "safe_normalize",
    "transform_points",
]

import torch
from jaxtyping import Float
from torch import Tensor

_MIN_SQUARED_ANGLE = 1e-24
# Below this squared angle, sin(a)/a is 1 and (1 - cos(a))/a² is ½ to the last bit of float32.
SMALL_ANGLE = 1e-12


def safe_normalize(
    vector: Float[Tensor, "... k"], *, smallest: float = _MIN_SQUARED_ANGLE
) -> Float[Tensor, "... k"]:
    """Scale vectors to unit length; a zero vector stays zero instead of becoming NaN.

    Args:
        vector: Any vectors, along the last axis.
        smallest: Lower bound of the squared length, above float32's smallest normal 1.2e-38.
    """
    squared_length = (vector * vector).sum(dim=-1, keepdim=True)
    return vector * torch.rsqrt(squared_length.clamp(min=smallest))


def quaternion_to_matrix(quaternion: Float[Tensor, "... 4"]) -> Float[Tensor, "... 3 3"]:
    """Convert quaternions (w, x, y, z), which need not be normalised, to rotation matrices."""
    w, x, y, z = safe_normalize(quaternion).unbind(dim=-1)
    entries = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )
    return torch.stack(entries, dim=-1).reshape(*quaternion.shape[:-1], 3, 3)


def matrix_to_quaternion(matrix: Float[Tensor, "... 3 3"]) -> Float[Tensor, "... 4"]:
    """Convert rotation matrices to unit quaternions (w, x, y, z); q and −q are the same rotation.

    Shepperd's method ("Quaternion from Rotation Matrix", Journal of Guidance and Control 1, 1978):
    of four forms, which each divide by one component, the one with the largest divisor is taken.
    """
    rows = matrix.flatten(-2).unbind(dim=-1)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows[:3], rows[3:6], rows[6:]
    # Four times the square of each component.
    squares = (1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz)
    # The quaternion times four times one of its components.
    quaternion_forms = (
        (squares[0], zy - yz, xz - zx, yx - xy),
        (zy - yz, squares[1], yx + xy, xz + zx),
        (xz - zx, yx + xy, squares[2], zy + yz),
        (yx - xy, xz + zx, zy + yz, squares[3]),
    )
    best_form, largest = torch.stack(quaternion_forms[0], dim=-1), squares[0]
    for quaternion_form, square in zip(quaternion_forms[1:], squares[1:], strict=True):
        larger_mask = square > largest
        best_form = torch.where(
            larger_mask[..., None], torch.stack(quaternion_form, dim=-1), best_form
        )
        largest = torch.maximum(square, largest)
    return safe_normalize(best_form)


def quaternion_multiply(
    a: Float[Tensor, "... 4"], b: Float[Tensor, "... 4"]
) -> Float[Tensor, "... 4"]:
    """Return the Hamilton product a b of quaternions (w, x, y, z): rotate by b, then by a."""
    aw, ax, ay, az = a.unbind(dim=-1)
    bw, bx, by, bz = b.unbind(dim=-1)
    entries = (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
    return torch.stack(entries, dim=-1)


def axis_angle_to_matrix(vector: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3 3"]:
    """Convert rotation vectors (axis times angle, in radians) to rotation matrices.

    Rodrigues' formula without normalisation: R = I + a K + b K² with a = sin θ / θ and
    b = 2 (sin ½θ / θ)². It needs no unit axis, so a zero vector is not a special case.
    """
    x, y, z = vector.unbind(dim=-1)
    angle = torch.sqrt((x * x + y * y + z * z).clamp(min=SMALL_ANGLE))
    a = torch.sin(angle) / angle
    half = torch.sin(0.5 * angle) / angle
    b = 2 * half * half
    entries = (
        1 - b * (y * y + z * z),
        b * x * y - a * z,
        b * x * z + a * y,
        b * x * y + a * z,
        1 - b * (x * x + z * z),
        b * y * z - a * x,
        b * x * z - a * y,
        b * y * z + a * x,
        1 - b * (x * x + y * y),
    )
    return torch.stack(entries, dim=-1).reshape(*vector.shape[:-1], 3, 3)


def transform_points(
    matrix: Float[Tensor, "*n 3 3"], point: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3"]:
    """Multiply each point with a 3×3 matrix: one for all points, or one per point."""
    x, y, z = point.chunk(3, dim=1)
    rows = matrix_entries(matrix)
    return torch.cat([a * x + b * y + c * z for a, b, c in rows], dim=1)


def matrix_entries(matrix: Float[Tensor, "*n 3 3"]) -> list[tuple[Tensor, ...]]:
    """Split 3×3 matrices into three rows of three entries, each a tensor [n, 1].

    Sums of products of such columns take a third of the time of many small matrix products.
    """
    entries = matrix.reshape(-1, 9).chunk(9, dim=1)
    return [entries[row : row + 3] for row in (0, 3, 6)]
