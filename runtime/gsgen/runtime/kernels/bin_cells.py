"""Bin cells: list the tiles of each cell, nearest cell first."""

__all__ = ["BinCells"]

from typing import Any, final

from gsgen.runtime.device import Device
from gsgen.runtime.kernels.bin_tiles import WALK_THREADS
from gsgen.runtime.kernels.counts import PLACES, Counts
from gsgen.runtime.kernels.kernel import Kernel, Step
from gsgen.runtime.kernels.shader import ROUND


@final
class BinCells:
    """``bin_cells.wgsl``.

    Args:
        device: Where it runs.
        walk: How many cells an invocation walks along.
        panorama: Whether the image is one.
    """

    def __init__(self, device: Device, walk: int, panorama: bool = False) -> None:
        constants = {"THREADS": WALK_THREADS, "RUN": walk, **PLACES}
        constants |= ROUND if panorama else {}
        self._measure, self._emit = (
            Kernel(device, "bin_cells", entry, ("urrrwww",), **constants)
            for entry in ("measure", "emit")
        )

    def steps(self, counts: Any, resources: tuple[Any, ...]) -> tuple[Step, Step]:
        """Return measuring and emitting; between them the measures are to be scanned.

        Args:
            counts: Of the cells.
            resources: What ``bin_cells.wgsl`` binds, in its order.
        """
        dispatch = (counts, 4 * Counts.WALK_VISIBLE_GROUPS)
        return (
            Step(self._measure, (self._measure.bind(*resources),), dispatch),
            Step(self._emit, (self._emit.bind(*resources),), dispatch),
        )
