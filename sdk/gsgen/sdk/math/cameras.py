"""Camera centre and frustum test from view and projection matrices in either memory order."""

__all__ = ["camera_centre", "frustum_mask"]

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

MatrixOrder = Literal["column", "row"]

_SMALLEST_SCALE = 1e-12


def camera_centre(view: Float[Tensor, "4 4"], order: MatrixOrder = "column") -> Float[Tensor, "3"]:
    """Return the camera centre −Rᵀ t / s² of a view matrix, in local space.

    Args:
        view: World→camera: a rotation times a uniform scale s, and a translation.
        order: The generator's ``space.matrix_order``: ``column`` if the tensor holds Mᵀ.

    A tensor of zeros, which runtimes feed initially, gives the origin.
    """
    matrix = _row_major_matrix(view, order)
    rotation, offset = matrix[:3, :3], matrix[:3, 3:4]
    square = (rotation * rotation).sum() / 3
    return -(rotation * offset).sum(dim=0) / square.clamp(min=_SMALLEST_SCALE)


def frustum_mask(
    position: Float[Tensor, "n 3"],
    view: Float[Tensor, "4 4"],
    projection: Float[Tensor, "4 4"],
    radius: Float[Tensor, " n"] | float = 0.0,
    *,
    margin: float = 0.1,
    order: MatrixOrder = "column",
) -> Float[Tensor, " n"]:
    """Return 1 for Gaussians that may be visible and 0 for those outside the view frustum.

    A sphere around each position is tested against the six planes of the frustum (Gribb and
    Hartmann 2001). The test is conservative: some invisible Gaussians stay, but no visible one is
    removed. Multiply opacity by the result, or pass it to :func:`gsgen.sdk.math.keep_rows`.

    Args:
        position: Centres.
        view: World→camera.
        projection: Camera→clip, depth 0..1; the sign of y does not matter.
        radius: Extent of a Gaussian: three standard deviations of its longest axis.
        margin: Enlargement of the frustum as a fraction of the image: a renderer's blur extends
            over the border.
        order: The generator's ``space.matrix_order``, of both matrices.

    If all matrices are zero, every Gaussian stays; a NaN position is removed.
    """
    clip = _row_major_matrix(projection, order) @ _row_major_matrix(view, order)
    x, y, z, w = clip.unbind(dim=0)
    limit = (1 + margin) * w
    planes = torch.stack([limit + x, limit - x, limit + y, limit - y, z, w - z], dim=0)
    normal = planes[:, :3]
    length = torch.sqrt((normal * normal).sum(dim=1))
    distance = position @ normal.transpose(0, 1) + planes[:, 3]
    extent = radius.reshape(-1, 1) * length if isinstance(radius, Tensor) else radius * length
    inside_mask = (distance + extent >= 0).to(position.dtype)
    return _product_of_columns(inside_mask)


def _product_of_columns(columns: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
    """Return the row products of a table by Mul, since few runtimes have a ReduceProd kernel."""
    first, *factors = columns.unbind(dim=1)
    for factor in factors:
        first = first * factor
    return first


def _row_major_matrix(tensor: Float[Tensor, "4 4"], order: MatrixOrder) -> Float[Tensor, "4 4"]:
    return tensor.transpose(0, 1) if order == "column" else tensor
