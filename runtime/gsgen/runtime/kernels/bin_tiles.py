"""Bin: list the tiles that each splat touches, and where each tile's list begins and ends."""

__all__ = ["RANGE_THREADS", "WALK_THREADS", "BinTiles", "TileRanges"]

from typing import Any, Final, final

from gsgen.runtime.device import Device
from gsgen.runtime.kernels.counts import PLACES, Counts
from gsgen.runtime.kernels.kernel import Kernel, Step
from gsgen.runtime.kernels.sort import Cut

WALK_THREADS: Final = 64
RANGE_THREADS: Final = 256
_BINDINGS = "urrrrrwww"


@final
class BinTiles:
    """``bin_tiles.wgsl``.

    Args:
        device: Where it runs.
        cut: How work is cut.
    """

    def __init__(self, device: Device, cut: Cut) -> None:
        constants = {"THREADS": WALK_THREADS, "RUN": cut.walk, **PLACES}
        self._measure, self._emit = (
            Kernel(device, "bin_tiles", entry, (_BINDINGS,), **constants)
            for entry in ("measure", "emit")
        )

    def steps(self, counts: Any, *resources: Any) -> tuple[Step, Step]:
        """Return measuring and emitting; between them the measures are to be scanned."""
        dispatch = (counts, 4 * Counts.WALK_VISIBLE_GROUPS)
        frame, *rest = resources
        return (
            Step(self._measure, (self._measure.bind(frame, counts, *rest),), dispatch),
            Step(self._emit, (self._emit.bind(frame, counts, *rest),), dispatch),
        )


@final
class TileRanges:
    """``tile_ranges.wgsl``."""

    def __init__(self, device: Device) -> None:
        self.kernel = Kernel(
            device, "tile_ranges", "mark", ("rrw",), THREADS=RANGE_THREADS, **PLACES
        )

    def step(self, counts: Any, tiles: Any, ranges: Any) -> Step:
        """Return the marking of where each tile's pairs begin and end."""
        bind = self.kernel.bind(counts, tiles, ranges)
        return Step(self.kernel, (bind,), (counts, 4 * Counts.WALK_PAIRS_GROUPS))
