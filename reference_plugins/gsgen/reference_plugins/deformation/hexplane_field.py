"""Evaluates a hexplane at fixed points over time.

A hexplane (4DGaussians, ``scene/hexplane.py``; Cao and Johnson 2023, "HexPlane")
multiplies the features of six planes. Three of them have no time axis: their product is constant
for each point. In the other three, a time selects one row of cells, in which each point always lies
between the same two cells with the same weights, so Gather replaces GridSample.

The model stores the products for few points, and the planes for many
(:mod:`gsgen.reference_plugins.tensors.baked_constants`).
"""

__all__ = ["HexPlaneField"]

from collections.abc import Sequence
from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.deformation.hexplane_checkpoint import HexPlaneNets
from gsgen.reference_plugins.tensors.baked_constants import Bake, Constants
from gsgen.reference_plugins.tensors.hexplane import SPACE_PLANES, TIME_PLANES


def _cell_below(
    along: Float[Tensor, " n"], cells: int
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 1"]]:
    """Split coordinates in [0, 1] into the lower grid index and the interpolation weight."""
    coordinate = (along * float(cells - 1)).clamp(0.0, float(cells - 1))
    below = torch.floor(coordinate).clamp(max=float(cells - 2))
    return below, (coordinate - below)[:, None]


class _CellIndex(nn.Module):
    """Splits coordinates in [0, 1] into the lower grid index and the interpolation weight."""

    def __init__(self, cells: int) -> None:
        super().__init__()
        self.cells = cells

    def forward(self, along: Float[Tensor, " n"]) -> tuple[Tensor, Tensor]:
        below, share = _cell_below(along, self.cells)
        return below.to(torch.int32), share


class _TimePlane(nn.Module):
    """A hexplane's plane of a space axis and time, evaluated at fixed points."""

    table: Tensor
    ticks: Tensor

    def __init__(
        self, plane: Float[Tensor, "c t x"], along: Float[Tensor, " n"], bake: Bake
    ) -> None:
        super().__init__()
        channels, moments, cells = plane.shape
        # Time from 0 to 1 is the upper half of a coordinate from −1 to 1.
        self.start, self.moments = (moments - 1) // 2, moments
        self.shape = (cells, channels)
        table = plane.permute(1, 2, 0)[self.start :]
        self.register_buffer("table", table.reshape(len(table), -1).contiguous())
        self.register_buffer("ticks", torch.arange(len(table), dtype=torch.float32)[None])
        self.cell = Constants(_CellIndex(cells), (along,), bake)

    def forward(self, time: Float[Tensor, "1"], along: Float[Tensor, " n"]) -> Float[Tensor, "n c"]:
        last = float(self.table.shape[0] - 1)
        moment = (time + 1) * (0.5 * (self.moments - 1)) - float(self.start)
        weight = torch.relu(1 - (self.ticks - moment.clamp(0.0, last).reshape(1, 1)).abs())
        row = (weight @ self.table).reshape(self.shape)
        # Differences of the few cells, rather than of the features of many points.
        slope = row[1:] - row[:-1]
        below, share = self.cell(along)
        low = torch.index_select(row, 0, below)
        features: Tensor = low + torch.index_select(slope, 0, below) * share
        return features


class _SpacePlane(nn.Module):
    """A hexplane's plane of two axes of space, interpolated bilinearly."""

    table: Tensor

    def __init__(self, plane: Float[Tensor, "c h w"], axes: tuple[int, int]) -> None:
        super().__init__()
        channels, self.height, self.width = plane.shape
        self.axes = axes
        table = plane.permute(1, 2, 0).reshape(-1, channels)
        self.register_buffer("table", table.contiguous())

    def forward(self, position: Float[Tensor, "n 3"]) -> Float[Tensor, "n c"]:
        across, down = self.axes
        column, right = _cell_below(position[:, across], self.width)
        row, lower = _cell_below(position[:, down], self.height)
        corner = row * float(self.width) + column
        # One gather per corner: a gather of all four would be four times the largest tensor.
        parts = []
        for below, right_cell in product((0, 1), repeat=2):
            share = (lower if below else 1 - lower) * (right if right_cell else 1 - right)
            index = (corner + float(below * self.width + right_cell)).to(torch.int32)
            parts.append(torch.index_select(self.table, 0, index) * share)
        return (parts[0] + parts[1]) + (parts[2] + parts[3])


class _SpacePlanes(nn.Module):
    """The product of a hexplane's three planes without time."""

    def __init__(self, planes: Sequence[Tensor]) -> None:
        super().__init__()
        self.planes = nn.ModuleList(
            _SpacePlane(planes[index], axes) for index, axes in SPACE_PLANES.items()
        )

    def forward(self, position: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n c"]]:
        first, second, third = (plane(position) for plane in self.planes)
        return (first * second * third,)


class _Resolution(nn.Module):
    """The product of a hexplane's six planes of one resolution."""

    def __init__(
        self, planes: Sequence[Tensor], position: Float[Tensor, "n 3"], bake: Bake
    ) -> None:
        super().__init__()
        self.space = Constants(_SpacePlanes(planes), (position,), bake)
        self.x, self.y, self.z = (
            _TimePlane(planes[plane], position[:, axis], bake)
            for axis, plane in enumerate(TIME_PLANES)
        )

    def forward(
        self, time: Float[Tensor, "1"], position: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n c"]:
        (space,) = self.space(position)
        x = self.x(time, position[:, 0])
        y = self.y(time, position[:, 1])
        z = self.z(time, position[:, 2])
        features: Tensor = space * (x * y * z)
        return features


class HexPlaneField(nn.Module):
    """The hexplane features of fixed points at any time."""

    corner: Tensor
    per_size: Tensor

    def __init__(
        self, nets: HexPlaneNets, position: Float[Tensor, "n 3"], bake: Bake = "auto"
    ) -> None:
        """Bake a hexplane at fixed points: store its space planes or, if smaller, their products.

        Points outside the box take the values of its border. ``bake``: ``always`` stores products
        of the planes of space, ``never`` the planes, ``auto`` the smaller ones.
        """
        super().__init__()
        # The first row of the box is its upper corner, so coordinates are mirrored.
        corner, opposite = nets.aabb
        self.register_buffer("corner", corner[None].clone())
        self.register_buffer("per_size", (1 / (opposite.double() - corner.double())).float()[None])
        scaled = (position.double() - corner.double()) / (opposite.double() - corner.double())
        self.resolutions = nn.ModuleList(_Resolution(six, scaled, bake) for six in nets.grids)

    def forward(
        self, time: Float[Tensor, "1"], position: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n f"]:
        """Return the hexplane features of fixed points at a given time, at all resolutions."""
        scaled = (position - self.corner) * self.per_size
        return torch.cat([resolution(time, scaled) for resolution in self.resolutions], dim=1)
