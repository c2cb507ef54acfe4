"""Features of points in a hexplane, where the points stay and only time goes by.

A hexplane (4DGaussians, ``scene/hexplane.py``; Cao and Johnson 2023, "HexPlane")
multiplies what six planes say, three of which know no time. Their product is a constant of each
point. Of the other three, a moment picks one row of cells, between whose two nearest cells each
point always lies with the same weights: Gather takes the place of GridSample.

Of few points the products are in the file, and of many the planes are
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

# Planes of two directions of space, and for x, y and z the plane with time.
_SPACE = {0: (0, 1), 1: (0, 2), 3: (1, 2)}
_TIME = (2, 4, 5)


def _between(
    along: Float[Tensor, " n"], cells: int
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 1"]]:
    """Return the cell below a coordinate from 0 to 1, a whole number, and the share of the next."""
    at = (along * float(cells - 1)).clamp(0.0, float(cells - 1))
    below = torch.floor(at).clamp(max=float(cells - 2))
    return below, (at - below)[:, None]


class _Cell(nn.Module):
    """Between which two of so many cells points lie, and where between them."""

    def __init__(self, cells: int) -> None:
        super().__init__()
        self.cells = cells

    def forward(self, along: Float[Tensor, " n"]) -> tuple[Tensor, Tensor]:
        below, share = _between(along, self.cells)
        return below.to(torch.int32), share


class _Moving(nn.Module):
    """One plane of a direction of space and time, looked up by points that stay."""

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
        self.cell = Constants(_Cell(cells), (along,), bake)

    def forward(
        self, time: Float[Tensor, "1"], along: Float[Tensor, " n"]
    ) -> Float[Tensor, "n c"]:
        last = float(self.table.shape[0] - 1)
        at = (time + 1) * (0.5 * (self.moments - 1)) - float(self.start)
        weight = torch.relu(1 - (self.ticks - at.clamp(0.0, last).reshape(1, 1)).abs())
        row = (weight @ self.table).reshape(self.shape)
        # Differences of cells, of which there are few, and not of what points find there.
        slope = row[1:] - row[:-1]
        below, share = self.cell(along)
        low = torch.index_select(row, 0, below)
        made: Tensor = low + torch.index_select(slope, 0, below) * share
        return made


class _Plane(nn.Module):
    """One plane of two directions of space."""

    table: Tensor

    def __init__(self, plane: Float[Tensor, "c h w"], axes: tuple[int, int]) -> None:
        super().__init__()
        channels, self.height, self.width = plane.shape
        self.axes = axes
        table = plane.permute(1, 2, 0).reshape(-1, channels)
        self.register_buffer("table", table.contiguous())

    def forward(self, place: Float[Tensor, "n 3"]) -> Float[Tensor, "n c"]:
        across, down = self.axes
        column, right = _between(place[:, across], self.width)
        row, lower = _between(place[:, down], self.height)
        corner = row * float(self.width) + column
        # A gather for each corner: one of all four would be four times the largest tensor.
        parts = []
        for below, beside in product((0, 1), repeat=2):
            share = (lower if below else 1 - lower) * (right if beside else 1 - right)
            index = (corner + float(below * self.width + beside)).to(torch.int32)
            parts.append(torch.index_select(self.table, 0, index) * share)
        return (parts[0] + parts[1]) + (parts[2] + parts[3])


class _Still(nn.Module):
    """The planes of two directions of space, multiplied."""

    def __init__(self, planes: Sequence[Tensor]) -> None:
        super().__init__()
        self.planes = nn.ModuleList(
            _Plane(planes[index], axes) for index, axes in _SPACE.items()
        )

    def forward(self, place: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n c"]]:
        first, second, third = (plane(place) for plane in self.planes)
        return (first * second * third,)


class _Resolution(nn.Module):
    """Six planes of one resolution, multiplied."""

    def __init__(
        self, planes: Sequence[Tensor], place: Float[Tensor, "n 3"], bake: Bake
    ) -> None:
        super().__init__()
        self.still = Constants(_Still(planes), (place,), bake)
        self.x, self.y, self.z = (
            _Moving(planes[plane], place[:, axis], bake) for axis, plane in enumerate(_TIME)
        )

    def forward(
        self, time: Float[Tensor, "1"], place: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n c"]:
        (still,) = self.still(place)
        x, y, z = (
            self.x(time, place[:, 0]),
            self.y(time, place[:, 1]),
            self.z(time, place[:, 2]),
        )
        made: Tensor = still * (x * y * z)
        return made


class HexPlaneField(nn.Module):
    """Features of all points at any moment."""

    corner: Tensor
    per_size: Tensor

    def __init__(
        self, nets: HexPlaneNets, position: Float[Tensor, "n 3"], bake: Bake = "auto"
    ) -> None:
        """Bake what time does not change, or the planes that it follows from.

        Args:
            nets: The planes.
            position: The points; outside the box the border goes on.
            bake: ``always`` stores products of the planes of space, ``never`` the planes, ``auto``
                whichever is smaller.
        """
        super().__init__()
        # The first row of the box is its upper corner, so coordinates are mirrored.
        corner, other = nets.aabb
        self.register_buffer("corner", corner[None].clone())
        self.register_buffer(
            "per_size", (1 / (other.double() - corner.double())).float()[None]
        )
        place = (position.double() - corner.double()) / (other.double() - corner.double())
        self.resolutions = nn.ModuleList(
            _Resolution(six, place, bake) for six in nets.grids
        )

    def forward(
        self, time: Float[Tensor, "1"], position: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n f"]:
        """Return the features of the points at ``time``, resolution by resolution."""
        place = (position - self.corner) * self.per_size
        return torch.cat([one(time, place) for one in self.resolutions], dim=1)
