"""Bin: list the tiles that each splat touches, nearest splat first."""

__all__ = ["WALK_THREADS", "BinTiles"]

from typing import Any, Final, final

from gsgen.runtime.device import Device
from gsgen.runtime.kernels.counts import PLACES, Counts
from gsgen.runtime.kernels.kernel import Kernel, Step

WALK_THREADS: Final = 64
_BINDINGS = "urrrrrwww"


@final
class BinTiles:
    """``bin_tiles.wgsl``.

    Args:
        device: Where it runs.
        walk: How many splats an invocation walks along.
    """

    def __init__(self, device: Device, walk: int) -> None:
        constants = {"THREADS": WALK_THREADS, "RUN": walk, **PLACES}
        self._measure, self._emit = (
            Kernel(device, "bin_tiles", entry, (_BINDINGS,), **constants)
            for entry in ("measure", "emit")
        )

    def steps(self, counts: Any, resources: tuple[Any, ...]) -> tuple[Step, Step]:
        """Return measuring and emitting; between them the measures are to be scanned.

        Args:
            counts: The frame's counts.
            resources: What ``bin_tiles.wgsl`` binds, in its order.
        """
        dispatch = (counts, 4 * Counts.WALK_VISIBLE_GROUPS)
        return (
            Step(self._measure, (self._measure.bind(*resources),), dispatch),
            Step(self._emit, (self._emit.bind(*resources),), dispatch),
        )
