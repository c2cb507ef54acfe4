"""The order of Gaussians in GPU memory, in which neighbours in space are neighbours."""

__all__ = ["MIN_ORDERED_ROWS", "SpatialOrder"]

from dataclasses import dataclass
from typing import Final, Self, final

import numpy as np
from jaxtyping import Int64, UInt32

from gsgen.contract.spec import layout
from gsgen.runtime.gpu.morton_order import morton_sorted_indices
from gsgen.runtime.scene.splat_data import SplatData

MIN_ORDERED_ROWS: Final = 1 << 15
"""Least number of Gaussians whose order in memory counts: fewer fit into a cache."""

_CHECK_INTERVAL: Final = 30  # changes before an order is checked, so that sorting costs little
_MAX_GAP_GROWTH: Final = 4.0  # growth of the distance of neighbours that makes an order stale
_SAMPLE_PAIRS: Final = 1024  # pairs of neighbours whose distances are measured


@final
@dataclass(slots=True, eq=False)
class SpatialOrder:
    """The Morton order of Gaussians at one time, which stays useful for small movements.

    Pictures are the same in any order: a stale order only costs time.

    Attributes:
        rows: Index of each row in this order; live rows are first.
        neighbours: Sampled rows, and the row after each.
        median_gap: Median distance of these neighbours when the order was computed.
        change_count: Number of changes of the rows since then.
    """

    rows: UInt32[np.ndarray, " n"]
    neighbours: Int64[np.ndarray, "2 m"]
    median_gap: float
    change_count: int = 0

    @classmethod
    def of(cls, data: SplatData) -> Self:
        """Compute the Morton order of the Gaussians that a splat set holds at present."""
        sorted_indices = morton_sorted_indices(data.rows[: data.count, layout.POSITION])
        rows = np.concatenate([sorted_indices, np.arange(data.count, len(data))]).astype(np.uint32)
        sample_rows = np.linspace(0, data.count - 2, _SAMPLE_PAIRS if data.count > 1 else 0)
        first = sample_rows.astype(np.int64)
        neighbours = sorted_indices[np.stack([first, first + 1])]
        return cls(rows, neighbours, _median_gap(data, neighbours))

    def is_valid_after_change(self, data: SplatData) -> bool:
        """Count a change of the Gaussians, and return whether their Morton order is still useful."""
        self.change_count += 1
        if self.change_count < _CHECK_INTERVAL:
            return True
        return _median_gap(data, self.neighbours) <= _MAX_GAP_GROWTH * self.median_gap


def _median_gap(data: SplatData, neighbours: Int64[np.ndarray, "2 m"]) -> float:
    """Return the median distance between neighbouring Gaussians in memory."""
    first, second = data.rows[neighbours][..., layout.POSITION].astype(np.float64)
    with np.errstate(invalid="ignore"):  # infinite positions have no distance
        median_gap = np.linalg.norm(first - second, axis=1)
    finite_gaps = median_gap[np.isfinite(median_gap)]
    return float(np.median(finite_gaps)) if len(finite_gaps) else 0.0
