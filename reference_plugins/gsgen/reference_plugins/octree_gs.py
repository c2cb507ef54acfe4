"""Octree-GS: anchors in levels of detail, of which a camera sees those that its distance asks for.

Ren et al. 2024, "Octree-GS: Towards Consistent Real-time Rendering with LOD-Structured 3D
Gaussians": the level that a distance asks for is log(d_max / d) to the base of the fork, plus a
shift that each anchor learns. Decoding is that of Scaffold-GS.
"""

__all__ = ["MODES", "LevelGate", "Levels", "OctreeGS"]

import math
from dataclasses import dataclass
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.anchor_generator import AnchorGenerator
from gsgen.reference_plugins.checkpoints.anchors import (
    AnchorCheckpoint,
    AnchorCloud,
    AnchorNets,
)
from gsgen.reference_plugins.checkpoints.errors import CheckpointInvalid
from gsgen.reference_plugins.selection import Selection

# How a level becomes a whole number → by how much it may fall short of that number.
MODES = {"round": 0.5, "floor": 0.0, "ceil": 1.0, "progressive": 1.0}

# The published code keeps a fading level this far from the next one.
_ALMOST = 0.9999
_ALWAYS = 1e30
_NEVER = -1.0
_SMALLEST_SQUARE = 1e-12


@dataclass(frozen=True, slots=True)
class Levels:
    """How levels follow from distances.

    Attributes:
        mode: One of ``MODES``.
        fork: By how much a level is finer than the one before.
        voxel: Edge of a cell of level 0.
        standard: The distance from which level 0 is right.
        top: The finest level.
    """

    mode: str
    fork: float
    voxel: float
    standard: float
    top: int

    @classmethod
    def of(cls, read: AnchorCheckpoint) -> "Levels":
        """Return what a checkpoint says.

        Raises:
            CheckpointInvalid: A number is one that no training writes.
        """
        cloud, cfg = read.cloud, read.cfg
        assert cloud.level is not None
        assert cloud.info is not None
        if len(cloud) < 2 or not (cloud.info[:2] > 0).all():
            what = f"info is {cloud.info[:2].tolist()}, wanted voxel size and distance, above 0"
            raise CheckpointInvalid(what, where=str(read.folder))
        mode = cfg.word("dist2level", "round", MODES)
        fork = cfg.number("fork", 2)
        if fork <= 1:
            raise CheckpointInvalid(
                f"fork is {fork:g}, wanted above 1", where=str(cfg.path)
            )
        top = int(cloud.level.max()) - int(cloud.level.min())
        return cls(mode, fork, float(cloud.info[0]), float(cloud.info[1]), top)


class LevelGate(nn.Module):
    """An anchor of level L is seen where a whole number made of the level asked for reaches L.

    The level that a distance d asks for is log(standard / d) / log(fork) + extra. Solved for d,
    that is one largest squared distance for each anchor, so a frame takes one comparison.
    """

    middle: Tensor
    furthest: Tensor
    start: Tensor
    least: Tensor
    most_share: Tensor

    def __init__(
        self, cloud: AnchorCloud, levels: Levels, *, half_cell: bool = True
    ) -> None:
        """Solve for distances, in float64.

        Args:
            cloud: The anchors, with levels.
            levels: How levels follow from distances.
            half_cell: Distances reach to the middle of an anchor's cell, not to its corner.
        """
        super().__init__()
        assert cloud.level is not None
        assert cloud.extra_level is not None
        level, extra = cloud.level[:, None].double(), cloud.extra_level[:, None].double()
        self.fading = levels.mode == "progressive"
        self.per_level = 1 / math.log(levels.fork)
        shift = levels.voxel / 2 * levels.fork**-level if half_cell else 0.0
        self.register_buffer("middle", (cloud.position + shift).float())
        furthest = levels.standard * levels.fork ** (extra - level + MODES[levels.mode])
        square = torch.where(level <= 0, _ALWAYS, furthest.square().clamp(max=_ALWAYS))
        square = torch.where(level > levels.top, _NEVER, square)
        self.register_buffer("furthest", square.float())
        if self.fading:
            start = extra - level + 1 + math.log(levels.standard) * self.per_level
            self.register_buffer("start", start.float())
            self.register_buffer("least", _ALMOST * (level <= 0).float())
            most = torch.where(level >= levels.top, _ALMOST, 1.0)
            self.register_buffer("most_share", most.float())

    def forward(self, centre: Float[Tensor, "1 3"]) -> Float[Tensor, "n 1"]:
        """Return 0 for anchors finer than their distance asks for; the last level fades in."""
        offset = self.middle - centre
        square = (offset * offset).sum(dim=1, keepdim=True)
        visible = (square <= self.furthest).to(square.dtype)
        if not self.fading:
            return visible
        logarithm = torch.log(square.clamp(min=_SMALLEST_SQUARE))
        fraction = self.start - (0.5 * self.per_level) * logarithm
        bounded = torch.minimum(torch.maximum(fraction, self.least), self.most_share)
        return visible * bounded


@final
class OctreeGS(AnchorGenerator):
    """Anchors of which a camera sees those that its distance asks for."""

    def __init__(
        self,
        cloud: AnchorCloud,
        nets: AnchorNets,
        levels: Levels,
        *,
        appearance: int | None = None,
        selection: Selection = Selection(),  # noqa: B008
    ) -> None:
        """Fold what the camera does not change.

        Args:
            cloud: The anchors, with levels.
            nets: Their networks.
            levels: How levels follow from distances.
            appearance: Which appearance to keep; an input chooses where absent.
            selection: Which anchors are decoded.
        """
        super().__init__(cloud, nets, appearance=appearance, selection=selection)
        self.gate = LevelGate(cloud, levels)

    @property
    def hides(self) -> bool:
        """Whether the method itself hides anchors from some cameras: it does."""
        return True

    def shown(self, centre: Float[Tensor, "1 3"]) -> Float[Tensor, "n 1"]:
        """Hide anchors finer than their distance asks for; the last level fades in."""
        seen: Tensor = self.gate(centre)
        return seen
