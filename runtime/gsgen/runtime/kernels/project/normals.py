"""Normals of Gaussians: the shortest axis of each, turned towards the camera."""

__all__ = ["NormalsKernel"]

from typing import final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import PAGE_SLOTS, Page
from gsgen.runtime.kernels.project.project import PAGE
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Kernel, Step


@final
class NormalsKernel:
    """The kernel ``normals.wgsl``, which computes the normal of each Gaussian.

    Args:
        device: Device of the kernel.
        packed: Whether rows are packed by compact_rows.py.
        slot_rows: Rows of a slot, for pages of a pool; 0 for others.
        placed: Whether splats are those of a slab, of which the kernel gets the indices as keys.
    """

    def __init__(
        self, device: Device, *, packed: bool = False, slot_rows: int = 0, placed: bool = False
    ) -> None:
        self.kernel = Kernel(
            device,
            "normals_pooled" if slot_rows else "normals",
            "find_normals",
            ("rw", "urru" if slot_rows else "ur"),
            THREADS=THREADS_PER_WORKGROUP,
            PACKED=packed,
            PLACED=placed,
            SLOT_ROWS=slot_rows,
            PAGE_SLOTS=PAGE_SLOTS,
        )

    def step(self, keys: Buffer, normals: Buffer, uniform: Buffer, slot: int, page: Page) -> Step:
        """Return the dispatch that computes the normals of the Gaussians whose buffers a page has."""
        page_uniform = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
        extra_buffers = () if page.slots is None else (page.appearance, page.slots.table)
        bind_groups = (
            self.kernel.bind(keys, normals),
            self.kernel.bind(page_uniform, page.rows, *extra_buffers, group=1),
        )
        return Step(self.kernel, bind_groups, (-(-page.capacity // THREADS_PER_WORKGROUP), 1, 1))
