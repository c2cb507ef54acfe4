"""Bilinear sampling of feature planes by Gather operators, which every runtime captures.

``F.grid_sample`` becomes GridSample, which is not captured above operator set 19 and wrong in
float16 in older browsers. Here four rows of a table are gathered and interpolated.
"""

__all__ = ["hex_plane", "sample_plane", "to_unit_cube", "tri_plane"]

from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.sdk.errors import GeneratorInvalid

Padding = Literal["border", "zeros"]
Combine = Literal["product", "sum", "concat"]

# The coordinates (of x, y, z, t) that span each plane; the first one is along the width.
_TRI_PLANE_AXES = ((0, 1), (0, 2), (1, 2))
_HEX_PLANE_AXES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def to_unit_cube(
    position: Float[Tensor, "n 3"], low: Float[Tensor, "3"], high: Float[Tensor, "3"]
) -> Float[Tensor, "n 3"]:
    """Map the points of a box to [−1, 1]³, the range of plane coordinates."""
    return (position - low) * (2 / (high - low)) - 1


def sample_plane(
    plane: Float[Tensor, "c h w"],
    coordinates: Float[Tensor, "n 2"],
    *,
    align_corners: bool = True,
    padding: Padding = "border",
) -> Float[Tensor, "n c"]:
    """Sample a feature plane at points like ``F.grid_sample(mode="bilinear")``.

    Args:
        plane: Features of H × W texels.
        coordinates: Coordinates in [−1, 1]: the first along the width, the second along the height.
        align_corners: ±1 are the centres of the outer texels; else their outer edges.
        padding: Value outside the plane: the nearest texel (``border``), or zeros.

    Raises:
        GeneratorInvalid: The shape is wrong, or the plane has more than 2²⁴ texels.
    """
    if plane.ndim != 3 or plane.shape[1] * plane.shape[2] > 1 << 24:
        message = f"shape is {list(plane.shape)}, expected [C, H, W] with H·W up to 2²⁴"
        raise GeneratorInvalid(message, where="sample_plane")
    _, height, width = plane.shape
    table = plane.permute(1, 2, 0).reshape(height * width, -1)
    columns, column_weights = _neighbouring_texels(
        coordinates[:, 0:1], width, align_corners=align_corners, padding=padding
    )
    rows, row_weights = _neighbouring_texels(
        coordinates[:, 1:2], height, align_corners=align_corners, padding=padding
    )
    texels = (rows * width)[:, :, None] + columns[:, None, :]
    corner_weights = row_weights[:, :, None] * column_weights[:, None, :]
    # One gather for all four corners: four kernels would cost more than the arithmetic.
    corners = table.index_select(0, texels.reshape(-1).to(torch.int32))
    weighted_corners = corners.reshape(-1, 4, table.shape[1]) * corner_weights.reshape(-1, 4, 1)
    return weighted_corners.sum(dim=1)


def _neighbouring_texels(
    coordinate: Float[Tensor, "n 1"], size: int, *, align_corners: bool, padding: Padding
) -> tuple[Float[Tensor, "n 2"], Float[Tensor, "n 2"]]:
    """Return the two neighbouring texels of a coordinate as float indices, and their weights."""
    half = 0.5 * (size - 1 if align_corners else size)
    texel = coordinate * half + 0.5 * (size - 1)
    if padding == "border":
        texel = texel.clamp(0, size - 1)
    low = torch.floor(texel)
    fraction = texel - low
    low = low.clamp(-2, size)  # far outside equals just outside, and fits an integer
    index = torch.cat([low, low + 1], dim=1)
    corner_weights = torch.cat([1 - fraction, fraction], dim=1)
    if padding == "zeros":
        corner_weights = corner_weights * (
            (index >= 0).to(index.dtype) * (index <= size - 1).to(index.dtype)
        )
    return index.clamp(0, size - 1), corner_weights


def tri_plane(
    planes: Sequence[Float[Tensor, "c h w"]],
    position: Float[Tensor, "n 3"],
    *,
    combine: Combine = "sum",
    align_corners: bool = True,
    padding: Padding = "border",
) -> Float[Tensor, "n f"]:
    """Sample the three feature planes of a tri-plane (Chan et al. 2022, "EG3D").

    Args:
        planes: Spanned by xy, xz and yz, the first coordinate along the width.
        position: In [−1, 1]³; :func:`to_unit_cube` maps a box to it.
        combine: Add, multiply or concatenate the features of the planes.
        align_corners: See :func:`sample_plane`.
        padding: See :func:`sample_plane`.

    Raises:
        GeneratorInvalid: The number of planes is not three.
    """
    return _sample_planes(
        planes,
        _TRI_PLANE_AXES,
        position,
        combine,
        align_corners=align_corners,
        padding=padding,
        where="tri_plane",
    )


def hex_plane(
    planes: Sequence[Float[Tensor, "c h w"]],
    position: Float[Tensor, "n 3"],
    time: Float[Tensor, "1"],
    *,
    combine: Combine = "product",
    align_corners: bool = True,
    padding: Padding = "border",
) -> Float[Tensor, "n f"]:
    """Sample six planes of space and time (Fridovich-Keil et al. 2023, "K-Planes", equation 2).

    Args:
        planes: Spanned by xy, xz, xt, yz, yt and zt, the first coordinate along the width; the
            order of 4D Gaussian Splatting, whose planes are [1, C, H, W].
        position: In [−1, 1]³; :func:`to_unit_cube` maps a box to it.
        time: In [−1, 1], one number for all positions.
        combine: Multiply, add or concatenate the features of the planes.
        align_corners: See :func:`sample_plane`.
        padding: See :func:`sample_plane`.

    Raises:
        GeneratorInvalid: The number of planes is not six.
    """
    moment = time.reshape(1, 1).expand(position.shape[0], 1)
    coordinates = torch.cat([position, moment], dim=1)
    return _sample_planes(
        planes,
        _HEX_PLANE_AXES,
        coordinates,
        combine,
        align_corners=align_corners,
        padding=padding,
        where="hex_plane",
    )


def _sample_planes(
    planes: Sequence[Tensor],
    axes: Sequence[tuple[int, int]],
    coordinates: Tensor,
    combine: Combine,
    *,
    align_corners: bool,
    padding: Padding,
    where: str,
) -> Tensor:
    if len(planes) != len(axes):
        message = f"{len(planes)} planes, expected {len(axes)}"
        raise GeneratorInvalid(message, where=where)
    samples = [
        sample_plane(
            plane.squeeze(0) if plane.ndim == 4 else plane,
            torch.stack([coordinates[:, a], coordinates[:, b]], dim=1),
            align_corners=align_corners,
            padding=padding,
        )
        for plane, (a, b) in zip(planes, axes, strict=True)
    ]
    if combine == "concat":
        return torch.cat(samples, dim=1)
    first, *other_samples = samples
    for sample in other_samples:
        first = first * sample if combine == "product" else first + sample
    return first
