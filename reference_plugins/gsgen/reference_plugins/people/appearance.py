"""What R3-Avatar's hexplane and decoder say of each Gaussian in one of the frames of training.

Frames are counted, so the share that each cell of time has in them is a table. Points stand still
in the planes, so the planes of space are constants.
"""

__all__ = ["Appearance"]

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.reference_plugins.people.r3_avatar_checkpoint import R3Checkpoint
from gsgen.reference_plugins.tensors.layers import Dense
from gsgen.sdk.math import sample_plane

# Planes of two directions of space, and for x, y and z the plane with time.
_SPACE = {0: (0, 1), 1: (0, 2), 3: (1, 2)}
_TIME = (2, 4, 5)


class _Moving(nn.Module):
    """One plane of a direction of space and time."""

    table: Tensor
    below: Tensor
    share: Tensor

    def __init__(self, plane: Float[Tensor, "c t x"], along: Float[Tensor, " n"]) -> None:
        super().__init__()
        cells = plane.shape[2]
        self.shape = (cells, plane.shape[0])
        at = ((along + 1) / 2 * (cells - 1)).clamp(0, cells - 1)
        below = at.floor().clamp(max=cells - 2)
        self.register_buffer("table", plane.permute(1, 2, 0).flatten(1).contiguous())
        self.register_buffer("below", below.to(torch.int32))
        self.register_buffer("share", (at - below).float()[:, None])

    def forward(self, moment: Float[Tensor, "1 t"]) -> Float[Tensor, "n c"]:
        row = (moment @ self.table).reshape(self.shape)
        slope = row[1:] - row[:-1]
        low = torch.index_select(row, 0, self.below)
        return low + torch.index_select(slope, 0, self.below) * self.share


class _Resolution(nn.Module):
    """Six planes of one resolution, multiplied."""

    still: Tensor
    moments: Tensor

    def __init__(
        self,
        planes: Sequence[Tensor],
        place: Float[Tensor, "n 3"],
        time: Float[Tensor, " f"],
    ) -> None:
        super().__init__()
        parts = [
            sample_plane(planes[index].double(), place[:, [a, b]])
            for index, (a, b) in _SPACE.items()
        ]
        self.register_buffer("still", (parts[0] * parts[1] * parts[2]).float().contiguous())
        count = planes[_TIME[0]].shape[1]
        at = ((time + 1) / 2 * (count - 1)).clamp(0, count - 1)[:, None]
        hats = torch.relu(1 - (torch.arange(count, dtype=torch.float64)[None] - at).abs())
        self.register_buffer("moments", hats.float())
        self.x, self.y, self.z = (
            _Moving(planes[plane], place[:, axis]) for axis, plane in enumerate(_TIME)
        )

    def forward(self, frame: Int[Tensor, "1"]) -> Float[Tensor, "n c"]:
        moment = torch.index_select(self.moments, 0, frame)
        made: Tensor = self.still * self.x(moment) * self.y(moment) * self.z(moment)
        return made


class Appearance(nn.Module):
    """The decoder and what it reads."""

    def __init__(self, read: R3Checkpoint, poses: Sequence[int]) -> None:
        """Bake what the frame does not change.

        Args:
            read: The checkpoint.
            poses: The pose id of each frame; time is id / origin − 1.
        """
        super().__init__()
        low, high = read.aabb.double()
        place = (read.canonical.position.double() - low) * (2 / (high - low)) - 1
        time = torch.tensor(list(poses), dtype=torch.float64) / read.origin - 1
        self.grids = nn.ModuleList(_Resolution(six, place, time) for six in read.grids)
        self.inner = nn.ModuleList(Dense(*layer) for layer in read.inner)
        heads = [read.heads[name] for name in ("warp", "scaling", "rotation", "opacity")]
        weight, bias = (torch.cat(both) for both in zip(*heads, strict=True))
        self.heads = Dense(weight, bias)

    def forward(self, frame: Int[Tensor, "1"]) -> Float[Tensor, "11 n"]:
        """Return planes: 3 of a shift, 3 of scale (to be squared), 4 of rotation, 1 of opacity."""
        hidden = torch.cat([one(frame) for one in self.grids], dim=1)
        for layer in self.inner:
            hidden = torch.relu(layer(hidden))
        made: Tensor = self.heads(hidden)
        return made.transpose(0, 1)
