"""Lists splat pool slots (streamed tiles) in view, so that only their Gaussians are projected."""

__all__ = ["CullSlots"]

from typing import Final, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import PAGE_SLOTS, Page
from gsgen.runtime.kernels.project.project import PAGE
from gsgen.runtime.kernels.project.projections import Projection, projection_constants
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Kernel, Step
from gsgen.runtime.kernels.shared.shader import JACOBIAN_MARGIN
from gsgen.runtime.scene.splat_pool import REACH_SIGMAS

CULL_MARGIN: Final = JACOBIAN_MARGIN / 2
"""How far beyond the image a tile slot counts as seen, in images: where Jacobians still vary."""


@final
class CullSlots:
    """The kernel ``cull_slots.wgsl``: lists splat pool slots (streamed tiles) that are in view.

    Args:
        device: Device of the kernel.
        slot_rows: Rows of a slot.
        projection: Where Gaussians are projected to.
        keys_only: Whether keys are those of the page alone, before a frame is drawn in slabs.
    """

    def __init__(
        self, device: Device, slot_rows: int, *, projection: Projection, keys_only: bool = False
    ) -> None:
        self.kernel = Kernel(
            device,
            "cull_slots",
            "cull_slots",
            ("uwwww", "urru"),
            THREADS=THREADS_PER_WORKGROUP,
            SLOT_ROWS=slot_rows,
            PAGE_SLOTS=PAGE_SLOTS,
            CULL_MARGIN=CULL_MARGIN,
            REACH=REACH_SIGMAS,
            KEYS_ONLY=keys_only,
            **projection_constants(projection),
        )

    def step(
        self, frame: Buffer, keys: Buffer, low_keys: Buffer, uniform: Buffer, slot: int, page: Page
    ) -> Step:
        """Return the dispatch that lists visible slots (of streamed tiles) in a page (buffers)."""
        assert page.slots is not None
        page_uniform = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
        bind_groups = (
            self.kernel.bind(frame, keys, low_keys, page.slots.seen, page.slots.dispatch),
            self.kernel.bind(page_uniform, page.rows, page.appearance, page.slots.table, group=1),
        )
        return Step(self.kernel, bind_groups, (page.slots.count, 1, 1))
