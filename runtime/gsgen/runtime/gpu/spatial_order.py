"""Arrangements: an order in which rows that are near in space are near in memory."""

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

_SERVES: Final = 30  # changes at least, so that finding orders is little of what they cost
_APART: Final = 4.0  # times as far as at first: neighbours are none any more
_SAMPLE: Final = 1024  # pairs of neighbours that stand for all


@final
@dataclass(slots=True, eq=False)
class SpatialOrder:
    """The order that rows were found to have at some moment; it outlives the moment.

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
    def found(cls, data: SplatData) -> Self:
        """Return the arrangement of the present rows."""
        along = along_curve(data.rows[: data.count, layout.POSITION])
        rows = np.concatenate([along, np.arange(data.count, len(data))]).astype(np.uint32)
        places = np.linspace(0, data.count - 2, _SAMPLE if data.count > 1 else 0)
        first = places.astype(np.int64)
        neighbours = along[np.stack([first, first + 1])]
        return cls(rows, neighbours, _apart(data, neighbours))

    def lasts(self, data: SplatData) -> bool:
        """Say, once for each change of the rows, whether they are still in a good order."""
        self.served += 1
        if self.served < _SERVES:
            return True
        return _apart(data, self.neighbours) <= _APART * self.apart


def _apart(data: SplatData, neighbours: Int64[np.ndarray, "2 m"]) -> float:
    """Return the median distance of neighbours."""
    one, other = data.rows[neighbours][..., layout.POSITION].astype(np.float64)
    with np.errstate(invalid="ignore"):  # of two that are infinitely far, nothing is known
        apart = np.linalg.norm(one - other, axis=1)
    known = apart[np.isfinite(apart)]
    return float(np.median(known)) if len(known) else 0.0
