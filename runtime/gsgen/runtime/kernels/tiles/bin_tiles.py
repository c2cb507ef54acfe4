"""Lists the image tiles that each splat touches, nearest splat first (binning)."""

__all__ = ["WALK_THREADS", "BinTiles"]

from typing import Final, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer, Resource
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS, Counts
from gsgen.runtime.kernels.shared.first_digits import FirstDigits
from gsgen.runtime.kernels.shared.kernel import Kernel, Step
from gsgen.runtime.kernels.shared.shader import TILE

WALK_THREADS: Final = 64
_BINDINGS_BY_PASS = {
    "bin_tiles": {"measure": "urrrwwwrr", "emit": "urrwwwwrr"},
    "bin_cells": {"measure": "urrrwww", "emit": "urrrwww"},
}


@final
class BinTiles:
    """The kernels of ``bin_tiles.wgsl`` or ``bin_cells.wgsl``: list image tiles that splats touch.

    Args:
        device: Device of the kernels.
        walk_rows: Splats per invocation.
        panorama: Whether the image is a panorama.
        digits: How the first digits of listed tiles are counted; None to list the tiles of cells
            instead of splats, and to count none.
        tile: Edge of a tile, in pixels.
        records: Whether each splat is one record.
    """

    def __init__(
        self,
        device: Device,
        walk_rows: int,
        *,
        panorama: bool = False,
        digits: FirstDigits | None = None,
        tile: int = TILE,
        records: bool = False,
    ) -> None:
        shader = "bin_cells" if digits is None else "bin_tiles"
        constants = {
            "THREADS": WALK_THREADS,
            "RUN": walk_rows,
            "TILE": tile,
            "RECORDS": records,
            "PANORAMA": panorama,
            **COUNT_CONSTANTS,
        }
        constants |= digits.constants if digits else {}
        self._measure_kernel, self._emit_kernel = (
            Kernel(device, shader, entry, (kinds,), **constants)
            for entry, kinds in _BINDINGS_BY_PASS[shader].items()
        )

    def steps(
        self, counts: Buffer, resources: tuple[Resource, ...], histogram: Buffer | None = None
    ) -> tuple[Step, Step]:
        """Return the dispatches that count the image tiles of each splat, then list these tiles.

        A prefix sum of the counts runs between the two.

        Args:
            counts: The frame's counts, or those of its cells.
            resources: Resources of the shader, in order.
            histogram: If digits are counted, the histogram to which they are added.
        """
        dispatch = (counts, 4 * Counts.WALK_VISIBLE_GROUPS)
        emit_resources = resources
        if histogram is not None:  # in place of the numbers of tiles, which only `measure` reads
            emit_resources = (*resources[:3], histogram, *resources[4:])
        return (
            Step(self._measure_kernel, (self._measure_kernel.bind(*resources),), dispatch),
            Step(self._emit_kernel, (self._emit_kernel.bind(*emit_resources),), dispatch),
        )
