"""Features of points in a hexplane, where the points stay and only time goes by.

A hexplane (4DGaussians, ``scene/hexplane.py``; Cao and Johnson 2023, "HexPlane")
multiplies what six planes say, three of which know no time. Their product is a constant of each
point. Of the other three, a moment picks one row of cells, between whose two nearest cells each
point always lies with the same weights: Gather takes the place of GridSample.
"""

__all__ = ["HexPlaneField"]

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.checkpoints.hexplanes import HexPlaneNets
from gsgen.sdk.math import sample_plane

# Planes of two directions of space, and for x, y and z the plane with time.
_SPACE = {0: (0, 1), 1: (0, 2), 3: (1, 2)}
_TIME = (2, 4, 5)


class _Moving(nn.Module):
    """One plane of a direction of space and time, looked up by points that stay."""

    table: Tensor
    ticks: Tensor
    below: Tensor
    share: Tensor

    def __init__(self, plane: Float[Tensor, "c t x"], along: Float[Tensor, " n"]) -> None:
        super().__init__()
        channels, moments, cells = plane.shape
        # Time from 0 to 1 is the upper half of a coordinate from −1 to 1.
        self.start, self.moments = (moments - 1) // 2, moments
        self.cells, self.channels = cells, channels
        table = plane.permute(1, 2, 0)[self.start :]
        self.register_buffer("table", table.reshape(len(table), -1).contiguous())
        self.register_buffer("ticks", torch.arange(len(table), dtype=torch.float32)[None])
        at = ((along + 1) / 2 * (cells - 1)).clamp(0, cells - 1)
        below = at.floor().clamp(max=cells - 2)
        self.register_buffer("below", below.to(torch.int32))
        self.register_buffer("share", (at - below).float()[:, None])

    def forward(self, time: Float[Tensor, "1"]) -> Float[Tensor, "n c"]:
        last = float(self.table.shape[0] - 1)
        at = (time + 1) * (0.5 * (self.moments - 1)) - float(self.start)
        weight = torch.relu(1 - (self.ticks - at.clamp(0.0, last).reshape(1, 1)).abs())
        row = (weight @ self.table).reshape(self.cells, self.channels)
        # Differences of cells, of which there are few, and not of what points find there.
        slope = row[1:] - row[:-1]
        low = torch.index_select(row, 0, self.below)
        return low + torch.index_select(slope, 0, self.below) * self.share


class _Resolution(nn.Module):
    """Six planes of one resolution, multiplied."""

    still: Tensor

    def __init__(self, planes: Sequence[Tensor], place: Float[Tensor, "n 3"]) -> None:
        super().__init__()
        parts = [
            sample_plane(planes[index].double(), place[:, [a, b]])
            for index, (a, b) in _SPACE.items()
        ]
        self.register_buffer("still", (parts[0] * parts[1] * parts[2]).float().contiguous())
        self.x, self.y, self.z = (
            _Moving(planes[plane], place[:, axis]) for axis, plane in enumerate(_TIME)
        )

    def forward(self, time: Float[Tensor, "1"]) -> Float[Tensor, "n c"]:
        moving: Tensor = self.x(time) * self.y(time) * self.z(time)
        return self.still * moving


class HexPlaneField(nn.Module):
    """Features of all points at any moment."""

    def __init__(self, nets: HexPlaneNets, position: Float[Tensor, "n 3"]) -> None:
        """Bake what time does not change.

        Args:
            nets: The planes.
            position: The points; outside the box the border goes on.
        """
        super().__init__()
        upper, lower = nets.aabb.double()
        # The first row of the box is its upper corner, so coordinates are mirrored.
        place = (position.double() - upper) * (2 / (lower - upper)) - 1
        self.resolutions = nn.ModuleList(_Resolution(six, place) for six in nets.grids)

    def forward(self, time: Float[Tensor, "1"]) -> Float[Tensor, "n f"]:
        """Return the features at ``time``, resolution by resolution."""
        return torch.cat([one(time) for one in self.resolutions], dim=1)
