"""Where a camera stands and what it can see, from matrices in either memory order."""

__all__ = ["camera_centre", "frustum_mask"]

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

Order = Literal["column", "row"]

_SMALLEST_SCALE = 1e-12


def camera_centre(
    view: Float[Tensor, "4 4"], order: Order = "column"
) -> Float[Tensor, "3"]:
    """Return the camera's centre, −Rᵀ t / s², in local space.

    Args:
        view: World→camera: a rotation times a uniform scale s, and a translation.
        order: The generator's ``space.matrix_order``: ``column`` if the tensor holds Mᵀ.

    A tensor of zeros, which runtimes feed before they know better, gives the origin.
    """
    matrix = _matrix(view, order)
    turn, shift = matrix[:3, :3], matrix[:3, 3:4]
    square = (turn * turn).sum() / 3
    return -(turn * shift).sum(dim=0) / square.clamp(min=_SMALLEST_SCALE)


def frustum_mask(
    position: Float[Tensor, "n 3"],
    view: Float[Tensor, "4 4"],
    projection: Float[Tensor, "4 4"],
    radius: Float[Tensor, " n"] | float = 0.0,
    *,
    margin: float = 0.1,
    order: Order = "column",
) -> Float[Tensor, " n"]:
    """Return 1 for what may be seen and 0 for what surely is not.

    A sphere around each position is compared with the six planes of the frustum (Gribb and
    Hartmann 2001), so some of what stays is not seen, and nothing that is seen goes. Multiply
    opacity by it, or move what stays forward with :func:`gsgen.sdk.math.keep_rows`.

    Args:
        position: Centres.
        view: World→camera.
        projection: Camera→clip, depth 0..1; the sign of y does not matter.
        radius: How far a Gaussian reaches: three standard deviations of its longest axis.
        margin: How much wider and higher than the image the frustum is taken, as a share: a
            renderer's blur reaches over the border.
        order: The generator's ``space.matrix_order``, of both matrices.

    Where all matrices are zero everything stays; where a position is NaN it goes.
    """
    clip = _matrix(projection, order) @ _matrix(view, order)
    x, y, z, w = clip.unbind(dim=0)
    wide = (1 + margin) * w
    planes = torch.stack([wide + x, wide - x, wide + y, wide - y, z, w - z], dim=0)
    normal = planes[:, :3]
    length = torch.sqrt((normal * normal).sum(dim=1))
    distance = position @ normal.transpose(0, 1) + planes[:, 3]
    reach = (
        radius.reshape(-1, 1) * length if isinstance(radius, Tensor) else radius * length
    )
    inside = (distance + reach >= 0).to(position.dtype)
    return _product(inside)


def _product(columns: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
    """Multiply columns; bool has fewer kernels than float, and ReduceProd fewer than Mul."""
    first, *others = columns.unbind(dim=1)
    for one in others:
        first = first * one
    return first


def _matrix(tensor: Float[Tensor, "4 4"], order: Order) -> Float[Tensor, "4 4"]:
    return tensor.transpose(0, 1) if order == "column" else tensor
