"""Evaluates R3-Avatar's hexplane and decoder for each Gaussian in one training frame.

The frames are a finite set, so the weights of the time cells are a table. The points are fixed, so
the product of the space planes is a constant.
"""

__all__ = ["Appearance"]

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.reference_plugins.people.r3_avatar_checkpoint import R3Checkpoint
from gsgen.reference_plugins.tensors.hexplane import SPACE_PLANES, TIME_PLANES
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.sdk.math import sample_plane


class _TimePlane(nn.Module):
    """A hexplane's plane of a space axis and time, evaluated at fixed points."""

    table: Tensor
    below: Tensor
    share: Tensor

    def __init__(self, plane: Float[Tensor, "c t x"], positions: Float[Tensor, " n"]) -> None:
        super().__init__()
        cells = plane.shape[2]
        self.shape = (cells, plane.shape[0])
        coordinate = ((positions + 1) / 2 * (cells - 1)).clamp(0, cells - 1)
        below = coordinate.floor().clamp(max=cells - 2)
        self.register_buffer("table", plane.permute(1, 2, 0).flatten(1).contiguous())
        self.register_buffer("below", below.to(torch.int32))
        self.register_buffer("share", (coordinate - below).float()[:, None])

    def forward(self, moment: Float[Tensor, "1 t"]) -> Float[Tensor, "n c"]:
        row = (moment @ self.table).reshape(self.shape)
        slope = row[1:] - row[:-1]
        low = torch.index_select(row, 0, self.below)
        return low + torch.index_select(slope, 0, self.below) * self.share


class _Resolution(nn.Module):
    """The product of a hexplane's six planes of one resolution, at fixed points."""

    spatial: Tensor
    moments: Tensor

    def __init__(
        self, planes: Sequence[Tensor], position: Float[Tensor, "n 3"], time: Float[Tensor, " f"]
    ) -> None:
        super().__init__()
        parts = [
            sample_plane(planes[index].double(), position[:, [a, b]])
            for index, (a, b) in SPACE_PLANES.items()
        ]
        self.register_buffer("spatial", (parts[0] * parts[1] * parts[2]).float().contiguous())
        count = planes[TIME_PLANES[0]].shape[1]
        coordinate = ((time + 1) / 2 * (count - 1)).clamp(0, count - 1)[:, None]
        hat_weights = torch.relu(
            1 - (torch.arange(count, dtype=torch.float64)[None] - coordinate).abs()
        )
        self.register_buffer("moments", hat_weights.float())
        self.x, self.y, self.z = (
            _TimePlane(planes[plane], position[:, axis]) for axis, plane in enumerate(TIME_PLANES)
        )

    def forward(self, frame: Int[Tensor, "1"]) -> Float[Tensor, "n c"]:
        moment = torch.index_select(self.moments, 0, frame)
        features: Tensor = self.spatial * self.x(moment) * self.y(moment) * self.z(moment)
        return features


class Appearance(nn.Module):
    """R3-Avatar's decoder of Gaussian attributes, with the hexplane that the decoder reads."""

    def __init__(self, read: R3Checkpoint, poses: Sequence[int]) -> None:
        """Precompute the values of R3-Avatar's hexplane that do not depend on the frame.

        The time of a pose is id / origin − 1.
        """
        super().__init__()
        low, high = read.aabb.double()
        position = (read.canonical.position.double() - low) * (2 / (high - low)) - 1
        time = torch.tensor(list(poses), dtype=torch.float64) / read.origin - 1
        self.grids = nn.ModuleList(
            _Resolution(six_planes, position, time) for six_planes in read.grids
        )
        self.inner = nn.ModuleList(Dense(*layer) for layer in read.inner)
        heads = [read.heads[name] for name in ("warp", "scaling", "rotation", "opacity")]
        weight, bias = (
            torch.cat(weights_and_biases) for weights_and_biases in zip(*heads, strict=True)
        )
        self.heads = Dense(weight, bias)

    def forward(self, frame: Int[Tensor, "1"]) -> Float[Tensor, "11 n"]:
        """Return a frame's offsets to position, √scale, rotation and opacity of the Gaussians."""
        hidden = torch.cat([grid(frame) for grid in self.grids], dim=1)
        for layer in self.inner:
            hidden = torch.relu(layer(hidden))
        attributes: Tensor = self.heads(hidden)
        return attributes.transpose(0, 1)
