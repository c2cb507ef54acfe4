"""Octree-GS: anchors in levels of detail, which the distance from the camera selects.

Ren et al. 2024, "Octree-GS: Towards Consistent Real-time Rendering with LOD-Structured 3D
Gaussians": the level for a distance d is log(d_max / d) to the base of the fork, plus a learnt
shift of each anchor. Decoding is that of Scaffold-GS.
"""

__all__ = ["LEVEL_ROUNDING", "SUPPORTED_OPTIONS", "LevelGate", "Levels", "OctreeGS"]

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
from gsgen.reference_plugins.anchors.anchor_generator import MIN_SQUARED_DISTANCE, AnchorGenerator
from gsgen.reference_plugins.anchors.selection import Selection
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.tensors.baked_constants import Constants

# Option of the training run → supported value, and the meaning of any other value.
SUPPORTED_OPTIONS = {"resolution_scales": ([1.0], "levels are those of images at full resolution")}
# Rounding of levels → how far a level may fall short of the whole number.
LEVEL_ROUNDING = {"round": 0.5, "floor": 0.0, "ceil": 1.0, "progressive": 1.0}

# The published code keeps a fading level below the next one by this factor.
_MAX_FADE = 0.9999
_ALWAYS_VISIBLE = 1e30
_NEVER_VISIBLE = -1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """The levels of detail of an anchor-based method, and the distances where they change."""

    mode: str  # rounding of levels, one of ``MODES``
    fork: float  # ratio of the cell sizes of a level and the next finer one
    voxel: float  # edge of a cell of level 0
    standard: float  # the distance that belongs to level 0
    top: int  # the finest level

    @classmethod
    def of(cls, checkpoint: AnchorCheckpoint) -> "Levels":
        """Read the levels of detail from a checkpoint of an anchor-based method."""
        cloud, cfg = checkpoint.cloud, checkpoint.run.cfg
        assert cloud.level is not None
        assert cloud.info is not None
        if len(cloud) < 2 or not (cloud.info[:2] > 0).all():
            message = (
                f"info is {cloud.info[:2].tolist()}, expected a voxel size and a distance above 0"
            )
            raise CheckpointInvalid(message, where=str(checkpoint.run.folder))
        mode = cfg.word("dist2level", "round", LEVEL_ROUNDING)
        fork = cfg.number("fork", 2)
        if fork <= 1:
            message = f"fork is {fork:g}, expected a number above 1"
            raise CheckpointInvalid(message, where=str(cfg.path))
        top = int(cloud.level.max()) - int(cloud.level.min())
        voxel, standard = (float(number) for number in cloud.info[:2])
        return cls(mode=mode, fork=fork, voxel=voxel, standard=standard, top=top)


class _Limits(nn.Module):
    """Computes distance limits of each anchor from its level of detail and learnt shift."""

    level: Tensor
    extra: Tensor

    def __init__(self, cloud: AnchorCloud, levels: Levels, *, half_cell: bool = True) -> None:
        super().__init__()
        assert cloud.level is not None
        assert cloud.extra_level is not None
        self.levels, self.half_cell = levels, half_cell
        self.register_buffer("level", cloud.level[:, None])
        self.register_buffer("extra", cloud.extra_level[:, None])

    def forward(self, anchor: Float[Tensor, "n 3"]) -> tuple[Tensor, ...]:
        levels, level = self.levels, self.level
        fork_logarithm = math.log(levels.fork)
        cell = 0.5 * levels.voxel * torch.exp(-fork_logarithm * level)
        cell_center = anchor + cell if self.half_cell else anchor
        start = self.extra - level
        level_growth = torch.exp(2 * fork_logarithm * (start + LEVEL_ROUNDING[levels.mode]))
        squared_distance = (levels.standard**2 * level_growth).clamp(max=_ALWAYS_VISIBLE)
        first = (level <= 0).to(squared_distance.dtype)
        squared_distance = squared_distance * (1 - first) + _ALWAYS_VISIBLE * first
        is_too_deep = (level > levels.top).to(squared_distance.dtype)
        squared_distance = squared_distance * (1 - is_too_deep) + _NEVER_VISIBLE * is_too_deep
        if levels.mode != "progressive":
            return cell_center, squared_distance
        start = start + (1 + math.log(levels.standard) / fork_logarithm)
        is_last_level = (level >= levels.top).to(squared_distance.dtype)
        return (
            cell_center,
            squared_distance,
            start,
            _MAX_FADE * first,
            1 - (1 - _MAX_FADE) * is_last_level,
        )


class LevelGate(nn.Module):
    """Hides anchors whose level of detail is too fine for their distance from the camera.

    The level of a distance d is log(standard / d) / log(fork) + extra. Solved for d, this is one
    largest squared distance for each anchor, so a frame needs one comparison.
    """

    anchor: Tensor

    def __init__(self, cloud: AnchorCloud, levels: Levels, *, half_cell: bool = True) -> None:
        super().__init__()
        self.per_level = 1 / math.log(levels.fork)
        self.register_buffer("anchor", cloud.position)
        limits = _Limits(cloud, levels, half_cell=half_cell)
        self.limits = Constants(limits, (cloud.position,))

    def forward(self, centre: Float[Tensor, "1 3"]) -> Float[Tensor, "n 1"]:
        """Return 1 for visible anchors, 0 for too fine ones; the last level of detail fades in."""
        cell_center, max_distance, *fading_limits = self.limits(self.anchor)
        offset = cell_center - centre
        squared_distance = (offset * offset).sum(dim=1, keepdim=True)
        visible: Tensor = (squared_distance <= max_distance).to(squared_distance.dtype)
        if not fading_limits:
            return visible
        start, min_fraction, max_fraction = fading_limits
        fork_logarithm = torch.log(squared_distance.clamp(min=MIN_SQUARED_DISTANCE))
        fraction = start - (0.5 * self.per_level) * fork_logarithm
        bounded_fraction = torch.minimum(torch.maximum(fraction, min_fraction), max_fraction)
        faded_visibility: Tensor = visible * bounded_fraction
        return faded_visibility


@final
class OctreeGS(AnchorGenerator):
    """Octree-GS as a generator model of anchors in levels of detail."""

    def __init__(
        self,
        cloud: AnchorCloud,
        nets: AnchorNets,
        levels: Levels,
        *,
        appearance: int | None = None,
        selection: Selection = Selection(),  # noqa: B008
        half_cell: bool = True,
    ) -> None:
        """Build the model; with ``half_cell``, distances are measured to octree cell centres."""
        super().__init__(cloud, nets, appearance=appearance, selection=selection)
        self.level_gate = LevelGate(cloud, levels, half_cell=half_cell)

    @property
    def can_hide_anchors(self) -> bool:
        """Whether anchors of fine levels of detail are hidden from distant cameras: always True."""
        return True

    def visible_share(self, centre: Float[Tensor, "1 3"]) -> Float[Tensor, "n 1"]:
        """Hide anchors that are too fine for their distance; the last level of detail fades in."""
        visible: Tensor = self.level_gate(centre)
        return visible
