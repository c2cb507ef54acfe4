"""Gather keys: sorted splats get other keys than those they were sorted by."""

__all__ = ["GatherKeys", "gather_reference"]

from typing import Any, Final, final

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.counts import PLACES, Counts
from gsgen.runtime.kernels.shared.kernel import Kernel, Step

_THREADS: Final = 64


@final
class GatherKeys:
    """``gather_keys.wgsl``.

    Args:
        device: Where it runs.
        block: Keys that a workgroup of the sort has.
    """

    def __init__(self, device: Device, block: int) -> None:
        self.kernel = Kernel(
            device,
            "gather_keys",
            "gather_keys",
            ("rrrw",),
            THREADS=_THREADS,
            BLOCK=block,
            **PLACES,
        )

    def step(self, counts: Any, keys: Any, order: Any, keys_out: Any) -> Step:
        """Return the step: ``keys_out`` gets the key of each visible splat of ``order``."""
        bind = self.kernel.bind(counts, keys, order, keys_out)
        return Step(self.kernel, (bind,), (counts, 4 * Counts.SORT_VISIBLE_GROUPS))


def gather_reference(
    keys: UInt32[np.ndarray, " m"], order: UInt32[np.ndarray, " n"]
) -> UInt32[np.ndarray, " n"]:
    """What ``gather_keys.wgsl`` must make."""
    return np.asarray(keys[order])
