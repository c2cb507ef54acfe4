"""Projects cells (groups of Gaussians) for weighted-sum rendering: depth, circle, tile count."""

__all__ = ["CELL_RADIUS_SIGMAS", "ProjectCells", "SlabCells"]

from typing import Final, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.kernels.project.project import PAGE
from gsgen.runtime.kernels.project.projections import Projection, projection_constants
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Kernel, Step

CELL_RADIUS_SIGMAS: Final = 2.0
"""Radius of a cell, in standard deviations (Liu et al. 2025, their code)."""


@final
class ProjectCells:
    """The kernel ``project_cells.wgsl``: projects groups of Gaussians for weighted sums."""

    def __init__(self, device: Device, *, projection: Projection = "plane") -> None:
        self.kernel = Kernel(
            device,
            "project_cells",
            "project_cells",
            ("uwwwrww", "ur"),
            THREADS=THREADS_PER_WORKGROUP,
            DRAWN=int(Counts.DRAWN),
            **projection_constants(projection),
            CELL_REACH=CELL_RADIUS_SIGMAS,
        )

    def step(
        self, outputs: tuple[Buffer, ...], uniform: Buffer, slot: int, cells: Buffer, count: int
    ) -> Step:
        """Return the dispatch that projects the cells (groups of Gaussians) of one splat set.

        Args:
            outputs: Resources of bind group 0 of the shader, in order.
            uniform: Buffer with the uniforms of all sets.
            slot: Index of this set's uniform.
            cells: Buffer of the set's cells.
            count: Number of cells.
        """
        page_uniform = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
        bind_groups = (self.kernel.bind(*outputs), self.kernel.bind(page_uniform, cells, group=1))
        return Step(self.kernel, bind_groups, (-(-count // THREADS_PER_WORKGROUP), 1, 1))


@final
class SlabCells:
    """The kernels of ``slab_cells.wgsl``: keys by which cells are in a slab, and the cells of one.

    Args:
        device: Device of the kernels.
        projection: Where Gaussians are projected to.
    """

    def __init__(self, device: Device, *, projection: Projection = "plane") -> None:
        self._keys_kernel, self._cells_kernel = (
            Kernel(
                device,
                "slab_cells",
                entry,
                (resources, "ur"),
                THREADS=THREADS_PER_WORKGROUP,
                **projection_constants(projection),
                CELL_REACH=CELL_RADIUS_SIGMAS,
            )
            for entry, resources in (("find_keys", "uw"), ("place_cells", "uwwwwr"))
        )

    def key_step(
        self, frame: Buffer, keys: Buffer, uniform: Buffer, slot: int, page: Page, cells: Buffer
    ) -> Step:
        """Return the dispatch that gives each Gaussian of a page (GPU buffers) its cell's key.

        Args:
            frame: The frame's uniform.
            keys: Keys of the page.
            uniform: Buffer with the uniforms of all pages.
            slot: Index of this page's uniform.
            page: The page.
            cells: Buffer of the page's cells.
        """
        return _dispatch_by_row(self._keys_kernel, (frame, keys), uniform, slot, page, cells)

    def cell_step(
        self, resources: tuple[Buffer, ...], uniform: Buffer, slot: int, page: Page, cells: Buffer
    ) -> Step:
        """Return the dispatch that writes the cells of a slab whose Gaussians begin in a page.

        Args:
            resources: Resources of bind group 0 of the shader, in order.
            uniform: Buffer with the uniforms of all pages.
            slot: Index of this page's uniform.
            page: The page.
            cells: Buffer of the page's cells.
        """
        return _dispatch_by_row(self._cells_kernel, resources, uniform, slot, page, cells)


def _dispatch_by_row(
    kernel: Kernel,
    resources: tuple[Buffer, ...],
    uniform: Buffer,
    slot: int,
    page: Page,
    cells: Buffer,
) -> Step:
    """Return a kernel's dispatch with one invocation per Gaussian of a page (GPU buffers)."""
    page_uniform = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
    bind_groups = (kernel.bind(*resources), kernel.bind(page_uniform, cells, group=1))
    return Step(kernel, bind_groups, (-(-page.capacity // THREADS_PER_WORKGROUP), 1, 1))
