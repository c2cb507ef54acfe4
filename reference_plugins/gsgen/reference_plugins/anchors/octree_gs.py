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

from gsgen.reference_plugins.anchors.anchor_checkpoint import (
    AnchorCheckpoint,
    AnchorCloud,
    AnchorNets,
)
from gsgen.reference_plugins.anchors.anchor_generator import AnchorGenerator
from gsgen.reference_plugins.anchors.selection import Selection
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.tensors.baked_constants import Constants

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
            what = f"info is {cloud.info[:2].tolist()}, expected voxel size and distance, above 0"
            raise CheckpointInvalid(what, where=str(read.folder))
        mode = cfg.word("dist2level", "round", MODES)
        fork = cfg.number("fork", 2)
        if fork <= 1:
            raise CheckpointInvalid(
                f"fork is {fork:g}, expected above 1", where=str(cfg.path)
            )
        top = int(cloud.level.max()) - int(cloud.level.min())
        return cls(mode, fork, float(cloud.info[0]), float(cloud.info[1]), top)


class _Limits(nn.Module):
    """What decides about each anchor, of its level and the shift that it learnt."""

    level: Tensor
    extra: Tensor

    def __init__(
        self, cloud: AnchorCloud, levels: Levels, *, half_cell: bool = True
    ) -> None:
        super().__init__()
        assert cloud.level is not None
        assert cloud.extra_level is not None
        self.levels, self.half_cell = levels, half_cell
        self.register_buffer("level", cloud.level[:, None])
        self.register_buffer("extra", cloud.extra_level[:, None])

    def forward(self, anchor: Float[Tensor, "n 3"]) -> tuple[Tensor, ...]:
        levels, level = self.levels, self.level
        logarithm = math.log(levels.fork)
        cell = 0.5 * levels.voxel * torch.exp(-logarithm * level)
        middle = anchor + cell if self.half_cell else anchor
        start = self.extra - level
        growth = torch.exp(2 * logarithm * (start + MODES[levels.mode]))
        square = (levels.standard**2 * growth).clamp(max=_ALWAYS)
        first = (level <= 0).to(square.dtype)
        square = square * (1 - first) + _ALWAYS * first
        deep = (level > levels.top).to(square.dtype)
        square = square * (1 - deep) + _NEVER * deep
        if levels.mode != "progressive":
            return middle, square
        start = start + (1 + math.log(levels.standard) / logarithm)
        last = (level >= levels.top).to(square.dtype)
        return middle, square, start, _ALMOST * first, 1 - (1 - _ALMOST) * last


class LevelGate(nn.Module):
    """An anchor of level L is seen where a whole number made of the level asked for reaches L.

    The level that a distance d asks for is log(standard / d) / log(fork) + extra. Solved for d,
    that is one largest squared distance for each anchor, so a frame takes one comparison.
    """

    anchor: Tensor

    def __init__(
        self, cloud: AnchorCloud, levels: Levels, *, half_cell: bool = True
    ) -> None:
        """Solve for distances.

        Args:
            cloud: The anchors, with levels.
            levels: How levels follow from distances.
            half_cell: Distances reach to the middle of an anchor's cell, not to its corner.
        """
        super().__init__()
        self.per_level = 1 / math.log(levels.fork)
        self.register_buffer("anchor", cloud.position)
        limits = _Limits(cloud, levels, half_cell=half_cell)
        self.limits = Constants(limits, (cloud.position,))

    def forward(self, centre: Float[Tensor, "1 3"]) -> Float[Tensor, "n 1"]:
        """Return 0 for anchors finer than their distance asks for; the last level fades in."""
        middle, furthest, *fading = self.limits(self.anchor)
        offset = middle - centre
        square = (offset * offset).sum(dim=1, keepdim=True)
        visible: Tensor = (square <= furthest).to(square.dtype)
        if not fading:
            return visible
        start, least, most = fading
        logarithm = torch.log(square.clamp(min=_SMALLEST_SQUARE))
        fraction = start - (0.5 * self.per_level) * logarithm
        bounded = torch.minimum(torch.maximum(fraction, least), most)
        seen: Tensor = visible * bounded
        return seen


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
