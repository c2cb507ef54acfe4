"""How well flat and long Gaussians align with the surface or the strand of their neighbours."""

__all__ = [
    "MAX_FITTING_DEVIATION",
    "RANDOM_DEVIATION",
    "Alignment",
    "is_of_shape",
    "measure_alignment",
]

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gsgen.contract._array_types import Bool
from gsgen.contract.probing.drawn_sample import (
    MAX_PLANAR_SCATTER,
    MIN_DRAWN_ROWS,
    MIN_LINEAR_SCATTER,
    DrawnSample,
)

# A deviation below this is that of Gaussians which follow their neighbours.
MAX_FITTING_DEVIATION = 0.3
# The mean of (d · a)² over unit vectors d that are drawn at random.
RANDOM_DEVIATION = 1 / 3

# A disc has a shortest axis below this fraction of its middle one, a needle a middle axis below
# this fraction of its longest; there is an alignment if most rows are discs or needles, or many
# rows discs where neighbours form no line.
_MAX_FLATNESS = 0.5
_MIN_SHAPE_SHARE, _MIN_DISC_SHARE = 0.6, 0.4


@dataclass(frozen=True, slots=True)
class Alignment:
    """The alignment of a sample of Gaussians with their neighbours.

    Attributes:
        deviation: 0 where each disc lies in the plane of its neighbours, and each needle on their
            line; 1 for directions drawn at random. Right scenes have 0.01 to 0.40, wrong
            quaternions and axes 0.49 to 1.3.
        axis: The axis that is compared: 0 is the thinnest, 2 the longest.
        shape: What the neighbours form.
    """

    deviation: float
    axis: Literal[0, 2]
    shape: Literal["plane", "line"]


def measure_alignment(sample: DrawnSample) -> Alignment | None:
    """Measure how discs or needles align with neighbouring Gaussians; None without such shapes."""
    scatter = sample.scatter_eigenvalues
    disc_mask, needle_mask = is_of_shape(sample, 0), is_of_shape(sample, 2)
    disc_share = _MIN_SHAPE_SHARE if sample.is_linear else _MIN_DISC_SHARE
    if (
        _has_enough_rows(disc_mask, disc_share)
        and (limit := scatter[disc_mask, 0].mean()) < MAX_PLANAR_SCATTER
    ):
        share = sample.neighbour_alignment(0)[disc_mask].mean()
        return Alignment(float((share - limit) / (RANDOM_DEVIATION - limit)), 0, "plane")
    if (
        _has_enough_rows(needle_mask)
        and (limit := scatter[needle_mask, 2].mean()) > MIN_LINEAR_SCATTER
    ):
        share = sample.neighbour_alignment(2)[needle_mask].mean()
        return Alignment(float((limit - share) / (limit - RANDOM_DEVIATION)), 2, "line")
    return None


def is_of_shape(sample: DrawnSample, axis: Literal[0, 2]) -> Bool[np.ndarray, " m"]:
    """Return the mask of disc-like (axis 0, thin) or needle-like (axis 2, long) Gaussians."""
    shortest_axis, middle_axis, longest_axis = sample.sigma.T
    return np.asarray(
        shortest_axis < _MAX_FLATNESS * middle_axis
        if axis == 0
        else middle_axis < _MAX_FLATNESS * longest_axis
    )


def _has_enough_rows(mask: Bool[np.ndarray, " m"], share: float = _MIN_SHAPE_SHARE) -> bool:
    return bool(mask.mean() >= share and np.count_nonzero(mask) >= MIN_DRAWN_ROWS // 2)
