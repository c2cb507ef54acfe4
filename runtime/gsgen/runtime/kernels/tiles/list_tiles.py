"""Lists the splats that touch each image tile, nearest first, on software drivers."""

__all__ = ["ListTiles", "run_count"]

from typing import Final, final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer, Resource
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Kernel, Step

_WORKGROUP_INVOCATIONS: Final = 8  # of a workgroup: as many as CPUs compute together
_MAX_WORKGROUPS: Final = 32
_MIN_WORKGROUPS: Final = 8
_MAX_RUN_COUNTERS: Final = 1 << 21  # beyond which there are fewer runs; 8 MiB


def run_count(tiles: int) -> int:
    """Return into how many parts the sorted splats are divided to be listed by image tile."""
    return _WORKGROUP_INVOCATIONS * int(
        np.clip(
            _MAX_RUN_COUNTERS // (_WORKGROUP_INVOCATIONS * tiles), _MIN_WORKGROUPS, _MAX_WORKGROUPS
        )
    )


@final
class ListTiles:
    """The kernels of ``list_tiles.wgsl`` and ``list_ranges.wgsl``, which list splats by tile.

    They count twice instead of sorting pairs of a splat and a tile, and read one word per splat
    that is in a small window of tiles.

    Args:
        device: Device of the kernels.
        panorama: Whether the image is a panorama.
    """

    def __init__(self, device: Device, *, panorama: bool = False) -> None:
        constants = {"PANORAMA": panorama, "RECORDS": False, **COUNT_CONSTANTS}
        self._tally_kernel, self._list_kernel = (
            Kernel(
                device,
                "list_tiles",
                "walk",
                ("urrrwwrrw",),
                THREADS=_WORKGROUP_INVOCATIONS,
                LISTS=lists,
                **constants,
            )
            for lists in (False, True)
        )
        self._tile_total_kernel, self._begin_kernel = (
            Kernel(
                device, "list_ranges", entry, ("urwww",),
                THREADS=THREADS_PER_WORKGROUP, RUNS=_WORKGROUP_INVOCATIONS, **constants,
            )
            for entry in ("total", "begin")
        )  # fmt: skip

    def steps(
        self, tiles: int, walk_buffers: tuple[Resource, ...], range_buffers: tuple[Buffer, ...]
    ) -> tuple[Step, Step, Step, Step]:
        """Return the dispatches that list the sorted splats of each image tile by counting.

        They count by run, count by tile, begin each list, and fill it. Totals are replaced by their
        prefix sums between the second and the third.

        Args:
            tiles: Number of tiles of the image.
            walk_buffers: Resources of ``list_tiles.wgsl``, in order.
            range_buffers: Resources of ``list_ranges.wgsl``, in order.
        """
        run_groups = (run_count(tiles) // _WORKGROUP_INVOCATIONS, 1, 1)
        tile_groups = (-(-tiles // THREADS_PER_WORKGROUP), 1, 1)
        return (
            Step(self._tally_kernel, (self._tally_kernel.bind(*walk_buffers),), run_groups),
            Step(
                self._tile_total_kernel,
                (self._tile_total_kernel.bind(*range_buffers),),
                tile_groups,
            ),
            Step(self._begin_kernel, (self._begin_kernel.bind(*range_buffers),), tile_groups),
            Step(self._list_kernel, (self._list_kernel.bind(*walk_buffers),), run_groups),
        )
