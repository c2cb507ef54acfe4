"""Adds up what shaders counted in a frame; raises if too many splats are in the image."""

__all__ = ["frame_counts"]

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt32

from gsgen.runtime.errors import CapacityExceeded
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.renderer.kernel_set import Kernels


def frame_counts(
    device: Device, kernels: Kernels, counts: Sequence[UInt32[np.ndarray, " n"]]
) -> UInt32[np.ndarray, " n"]:
    """Add up the GPU counters of depth-sorted and weighted-sum splats; of maxima take the largest.

    The capacity for splat-tile pairs is that of the first counters.

    Raises:
        CapacityExceeded: More splats are drawn than one GPU dispatch can assign to tiles.
    """
    most = kernels.max_binned_splats
    for part in counts:
        if (visible := int(part[Counts.VISIBLE])) > most:
            raise CapacityExceeded(
                f"the scene has {visible:,} splats in the image; {device.name} draws at most {most:,}",
                where="scene",
                hint="Draw fewer Gaussians, or a smaller part of the scene.",
            )
    total = np.asarray(np.sum(counts, axis=0), np.uint32)
    total[Counts.PAIR_CAPACITY] = counts[0][Counts.PAIR_CAPACITY]
    total[Counts.VISIBLE] = counts[0][Counts.VISIBLE] + total[Counts.DRAWN]
    total[Counts.WANTED_PAIRS] = max(part[Counts.WANTED_PAIRS] for part in counts)
    return total
