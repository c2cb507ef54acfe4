"""Lists splat pool slots (streamed tiles) in view, so that only their Gaussians are projected."""

__all__ = ["CullSlots", "seen_reference"]

from typing import Final, final

import numpy as np
from jaxtyping import Bool, Shaped

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import PAGE_SLOTS, Page
from gsgen.runtime.kernels.project.project import PAGE
from gsgen.runtime.kernels.shared.kernel import THREADS, Kernel, Step
from gsgen.runtime.kernels.shared.shader import JACOBIAN_MARGIN, PANORAMA_CONSTANTS
from gsgen.runtime.scene.camera import DILATION
from gsgen.runtime.scene.splat_pool import REACH

CULL_MARGIN: Final = JACOBIAN_MARGIN / 2
"""How far beyond the image a tile slot counts as seen, in images: where Jacobians still vary."""


@final
class CullSlots:
    """The kernel ``cull_slots.wgsl``: lists splat pool slots (streamed tiles) that are in view.

    Args:
        device: Device of the kernel.
        slot_rows: Rows of a slot.
        panorama: Whether the image is a panorama.
        keys_only: Whether keys are those of the page alone, before a frame is drawn in slabs.
    """

    def __init__(
        self, device: Device, slot_rows: int, *, panorama: bool, keys_only: bool = False
    ) -> None:
        self.kernel = Kernel(
            device,
            "cull_slots",
            "cull_slots",
            ("uwwww", "urru"),
            THREADS=THREADS,
            SLOT_ROWS=slot_rows,
            PAGE_SLOTS=PAGE_SLOTS,
            CULL_MARGIN=CULL_MARGIN,
            REACH=REACH,
            KEYS_ONLY=keys_only,
            **(PANORAMA_CONSTANTS if panorama else {}),
        )

    def step(
        self, frame: Buffer, keys: Buffer, lows: Buffer, uniform: Buffer, slot: int, page: Page
    ) -> Step:
        """Return the dispatch that lists visible slots (of streamed tiles) in a page (buffers)."""
        assert page.slots is not None
        page_uniform = (uniform, slot * PAGE.itemsize, PAGE.itemsize)
        binds = (
            self.kernel.bind(frame, keys, lows, page.slots.seen, page.slots.dispatch),
            self.kernel.bind(page_uniform, page.rows, page.appearance, page.slots.table, group=1),
        )
        return Step(self.kernel, binds, (page.slots.count, 1, 1))


def seen_reference(
    slots: Shaped[np.ndarray, " s"], frame: Shaped[np.ndarray, ""], page: Shaped[np.ndarray, ""]
) -> Bool[np.ndarray, " s"]:
    """Return the mask of pool slots (streamed tiles) in view: ``cull_slots.wgsl`` in NumPy.

    All eight corners of a box are tested against each of the four planes and the near plane, which
    is another way to the same result as the shader's extents.
    """
    drawn = (slots["fade"] > 0) & (slots["live"] > 0)
    dilation = REACH * np.sqrt(DILATION + frame["extra_dilation"])
    if (CULL_MARGIN * frame["size"] < dilation).any():
        return np.asarray(drawn)
    linear = np.asarray(page["linear"], np.float64)[:, :3].T
    boxes = np.stack([slots["low"], slots["high"]], axis=1).astype(np.float64)
    choices = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T
    corners = np.take_along_axis(boxes, np.broadcast_to(choices, (len(slots), 8, 3)), axis=1)
    eye = slots["eye"].astype(np.float64) + slots["eye_rest"]
    at = (corners - eye[:, None]) @ linear.T
    inside_low = at[..., :2] - frame["slope_low"] * at[..., 2:] >= 0
    inside_high = at[..., :2] - frame["slope_high"] * at[..., 2:] <= 0
    sides = inside_low.any(axis=1).all(axis=1) & inside_high.any(axis=1).all(axis=1)
    in_front = (at[..., 2] > frame["near"]).any(axis=1)
    return np.asarray(drawn & sides & in_front)
