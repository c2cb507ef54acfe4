"""Counts the used rows of each GPU buffer of Gaussians, from a total that only the GPU knows."""

__all__ = ["LiveCounts"]

from typing import final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import PAGE_ROWS
from gsgen.runtime.kernels.shared.kernel import THREADS, Kernel, Step


@final
class LiveCounts:
    """The kernel ``live_counts.wgsl``: counts the used rows of each of up to 64 GPU buffers."""

    def __init__(self, device: Device) -> None:
        self.kernel = Kernel(
            device, "live_counts", "divide", ("rw",), THREADS=THREADS, PAGE_ROWS=PAGE_ROWS
        )

    def step(self, total: Buffer, live: Buffer) -> Step:
        """Return the dispatch that counts the used rows of each page (GPU buffers of Gaussians).

        Args:
            total: The number of live rows, as int32.
            live: One word per page.
        """
        return Step(self.kernel, (self.kernel.bind(total, live),), (1, 1, 1))
