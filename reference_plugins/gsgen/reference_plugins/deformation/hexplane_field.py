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


def _cell_below_coordinate(
    positions: Float[Tensor, " n"], cells: int
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 1"]]:
    """Split coordinates in [0, 1] into the lower grid index and the interpolation weight."""
    coordinate = (positions * float(cells - 1)).clamp(0.0, float(cells - 1))
    cell_below = torch.floor(coordinate).clamp(max=float(cells - 2))
    return cell_below, (coordinate - cell_below)[:, None]


class _CellIndex(nn.Module):
    """Splits coordinates in [0, 1] into the lower grid index and the interpolation weight."""

    def __init__(self, cells: int) -> None:
        super().__init__()
        self.cells = cells

    def forward(self, positions: Float[Tensor, " n"]) -> tuple[Tensor, Tensor]:
        cell_below, fraction = _cell_below_coordinate(positions, self.cells)
        return cell_below.to(torch.int32), fraction


class _TimePlane(nn.Module):
    """A hexplane's plane of a space axis and time, evaluated at fixed points."""

    table: Tensor
    ticks: Tensor

    def __init__(
        self, plane: Float[Tensor, "c t x"], positions: Float[Tensor, " n"], bake: Bake
    ) -> None:
        super().__init__()
        channels, time_count, cells = plane.shape
        # Time from 0 to 1 is the upper half of a coordinate from −1 to 1.
        self.start, self.moments = (time_count - 1) // 2, time_count
        self.shape = (cells, channels)
        table = plane.permute(1, 2, 0)[self.start :]
        self.register_buffer("table", table.reshape(len(table), -1).contiguous())
        self.register_buffer("ticks", torch.arange(len(table), dtype=torch.float32)[None])
        self.cell = Constants(_CellIndex(cells), (positions,), bake)

    def forward(
        self, time: Float[Tensor, "1"], positions: Float[Tensor, " n"]
    ) -> Float[Tensor, "n c"]:
        last_row = float(self.table.shape[0] - 1)
        moment = (time + 1) * (0.5 * (self.moments - 1)) - float(self.start)
        weight = torch.relu(1 - (self.ticks - moment.clamp(0.0, last_row).reshape(1, 1)).abs())
        row = (weight @ self.table).reshape(self.shape)
        # Differences of the few cells, rather than of the features of many points.
        slope = row[1:] - row[:-1]
        cell_below, fraction = self.cell(positions)
        row_below = torch.index_select(row, 0, cell_below)
        features: Tensor = row_below + torch.index_select(slope, 0, cell_below) * fraction
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
        column_axis, row_axis = self.axes
        column, column_fraction = _cell_below_coordinate(position[:, column_axis], self.width)
        row, row_fraction = _cell_below_coordinate(position[:, row_axis], self.height)
        corner = row * float(self.width) + column
        # One gather per corner: a gather of all four would be four times the largest tensor.
        parts = []
        for cell_below, right_cell in product((0, 1), repeat=2):
            fraction = (row_fraction if cell_below else 1 - row_fraction) * (
                column_fraction if right_cell else 1 - column_fraction
            )
            index = (corner + float(cell_below * self.width + right_cell)).to(torch.int32)
            parts.append(torch.index_select(self.table, 0, index) * fraction)
        return (parts[0] + parts[1]) + (parts[2] + parts[3])


class _SpacePlanes(nn.Module):
    """The product of a hexplane's three planes without time."""

    def __init__(self, planes: Sequence[Tensor]) -> None:
        super().__init__()
        self.planes = nn.ModuleList(
            _SpacePlane(planes[index], axes) for index, axes in SPACE_PLANES.items()
        )

    def forward(self, position: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n c"]]:
        first_planes, second_planes, third_planes = (plane(position) for plane in self.planes)
        return (first_planes * second_planes * third_planes,)


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
        corner, opposite_corner = nets.aabb
        self.register_buffer("corner", corner[None].clone())
        self.register_buffer(
            "per_size", (1 / (opposite_corner.double() - corner.double())).float()[None]
        )
        scaled_position = (position.double() - corner.double()) / (
            opposite_corner.double() - corner.double()
        )
        self.resolutions = nn.ModuleList(
            _Resolution(six_planes, scaled_position, bake) for six_planes in nets.grids
        )

    def forward(
        self, time: Float[Tensor, "1"], position: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n f"]:
        """Return the hexplane features of fixed points at a given time, at all resolutions."""
        scaled_position = (position - self.corner) * self.per_size
        return torch.cat(
            [resolution(time, scaled_position) for resolution in self.resolutions], dim=1
        )
