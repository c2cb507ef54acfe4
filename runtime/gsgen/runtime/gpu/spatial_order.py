"""Spatial order of rows: neighbours in space are neighbours in memory."""

__all__ = ["ARRANGED_FROM", "SpatialOrder"]

from dataclasses import dataclass
from typing import Final, Self, final

import numpy as np
from jaxtyping import Int64, UInt32

from gsgen.contract.spec import layout
from gsgen.runtime.gpu.morton_order import along_curve
from gsgen.runtime.scene.splat_data import SplatData

ARRANGED_FROM: Final = 1 << 15
"""Rows from which on their order in memory counts: fewer are in a cache anyway."""

_SERVES: Final = 30  # changes at least, so that sorting costs little in comparison
_APART: Final = 4.0  # times as far as at first: then the order is out of date
_SAMPLE: Final = 1024  # pairs of neighbours that stand for all


@final
@dataclass(slots=True, eq=False)
class SpatialOrder:
    """The Morton order of rows at some moment; it stays useful while they move.

    Pictures are the same in any order, so that an old one costs time at worst.

    Attributes:
        rows: Which row is where; live ones are first.
        neighbours: Some rows, and the one after each.
        apart: How far those were from each other when the order was found.
        served: How many changes of the values it has lasted for.
    """

    rows: UInt32[np.ndarray, " n"]
    neighbours: Int64[np.ndarray, "2 m"]
    apart: float
    served: int = 0

    @classmethod
    def of(cls, data: SplatData) -> Self:
        """Return the spatial order of the present rows."""
        along = along_curve(data.rows[: data.count, layout.POSITION])
        rows = np.concatenate([along, np.arange(data.count, len(data))]).astype(np.uint32)
        samples = np.linspace(0, data.count - 2, _SAMPLE if data.count > 1 else 0)
        first = samples.astype(np.int64)
        neighbours = along[np.stack([first, first + 1])]
        return cls(rows, neighbours, _apart(data, neighbours))

    def is_valid_after_change(self, data: SplatData) -> bool:
        """Count a change of the rows, and return whether the order is still good."""
        self.served += 1
        if self.served < _SERVES:
            return True
        return _apart(data, self.neighbours) <= _APART * self.apart


def _apart(data: SplatData, neighbours: Int64[np.ndarray, "2 m"]) -> float:
    """Return the median distance of neighbours."""
    first, second = data.rows[neighbours][..., layout.POSITION].astype(np.float64)
    with np.errstate(invalid="ignore"):  # of two that are infinitely far, nothing is known
        apart = np.linalg.norm(first - second, axis=1)
    known = apart[np.isfinite(apart)]
    return float(np.median(known)) if len(known) else 0.0
