"""Gives the Gaussians of a depth range consecutive indices, in the order of their rows."""

__all__ = ["PAGE_BYTES", "PLACEMENT_BLOCK_ROWS", "PlaceSplatsKernel"]

from typing import Final, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.kernels.project.project import PAGE
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Kernel, Step

_ROWS_PER_INVOCATION: Final = 16  # of an invocation
PLACEMENT_BLOCK_ROWS: Final = THREADS_PER_WORKGROUP * _ROWS_PER_INVOCATION
"""Rows of a workgroup."""

PAGE_BYTES: Final = 256
"""Bytes between the entries of two pages (splat buffers): every device binds such offsets."""


@final
class PlaceSplatsKernel:
    """The kernels of ``place_splats.wgsl``, which index the splats of a depth slab consecutively.

    Args:
        device: Device of the kernels.
        is_reordered: Whether the order of rows in memory differs from that of their sets.
    """

    def __init__(self, device: Device, *, is_reordered: bool) -> None:
        self._kernels = [
            Kernel(
                device,
                "place_splats",
                entry,
                ("urwwwrwww", "u"),
                THREADS=THREADS_PER_WORKGROUP,
                RUN=_ROWS_PER_INVOCATION,
                ARRANGED=is_reordered,
                PAGE_STEP=PAGE_BYTES // 4,
                **COUNT_CONSTANTS,
            )
            for entry in ("count", "place")
        ]

    def steps(
        self,
        resources: tuple[Buffer, ...],
        page_ends: Buffer,
        uniform: Buffer,
        slot: int,
        page: Page,
    ) -> list[Step]:
        """Return the dispatches that give the splats of one page (GPU buffers) consecutive indices.

        Args:
            resources: Resources of bind group 0 of the shader without ``page_ends``, in order.
            page_ends: The number of splats before each page and after the last, PAGE_BYTES apart.
            uniform: Buffer with the uniforms of all pages.
            slot: Index of the page in both.
            page: The page.
        """
        part = (page_ends, slot * PAGE_BYTES, 2 * PAGE_BYTES)
        page_binding = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
        groups = (-(-page.capacity // PLACEMENT_BLOCK_ROWS), 1, 1)
        return [
            Step(
                kernel,
                (
                    kernel.bind(*resources[:3], part, *resources[3:]),
                    kernel.bind(page_binding, group=1),
                ),
                groups,
            )
            for kernel in self._kernels
        ]
