"""Counts the depth sort keys of Gaussians by their leading bits."""

__all__ = ["BIN_COUNT", "CountKeysKernel"]

from typing import Final, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.kernels.project.project import PAGE
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Kernel, Step

BIN_COUNT: Final = 1 << 12
"""Numbers of a tally."""


@final
class CountKeysKernel:
    """The kernel ``tally_keys.wgsl``, which counts depth sort keys by their leading bits."""

    def __init__(self, device: Device) -> None:
        self.kernel = Kernel(
            device, "tally_keys", "tally_keys", ("urw", "u"), THREADS=THREADS_PER_WORKGROUP
        )

    def step(
        self, slab: Buffer, keys: Buffer, tally: Buffer, uniform: Buffer, slot: int, page: Page
    ) -> Step:
        """Return the dispatch that adds the sort keys of a page (GPU buffers) to a histogram.

        Args:
            slab: Uniform of the counted range of keys.
            keys: Keys of the page.
            tally: One number per bin.
            uniform: Buffer with the uniforms of all pages.
            slot: Index of this page's uniform.
            page: The page.
        """
        bind_groups = (
            self.kernel.bind(slab, keys, tally),
            self.kernel.bind((uniform, slot * PAGE.itemsize, PAGE.itemsize), group=1),
        )
        return Step(self.kernel, bind_groups, (-(-page.capacity // THREADS_PER_WORKGROUP), 1, 1))
