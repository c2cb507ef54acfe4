"""Gathers a second sort key of each splat, in sorted order, for the next sort."""

__all__ = ["GatherKeys"]

from typing import final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS, Counts
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Kernel, Step


@final
class GatherKeys:
    """The kernel ``gather_keys.wgsl``, which gathers second sort keys in sorted order."""

    def __init__(self, device: Device, block: int) -> None:
        self.kernel = Kernel(
            device,
            "gather_keys",
            "gather_keys",
            ("rrrw",),
            THREADS=THREADS_PER_WORKGROUP,
            BLOCK=block,
            **COUNT_CONSTANTS,
        )

    def step(self, counts: Buffer, keys: Buffer, order: Buffer, gathered_keys: Buffer) -> Step:
        """Return the dispatch that writes the second sort key of each visible splat, in order."""
        bind = self.kernel.bind(counts, keys, order, gathered_keys)
        return Step(self.kernel, (bind,), (counts, 4 * Counts.SORT_VISIBLE_GROUPS))
