"""Lists the image tiles that each splat touches, nearest splat first (binning)."""

__all__ = ["WALK_THREADS", "BinTiles", "touched_reference"]

from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS, Counts
from gsgen.runtime.kernels.shared.first_digits import FirstDigits
from gsgen.runtime.kernels.shared.kernel import Kernel, Step
from gsgen.runtime.kernels.shared.shader import PANORAMA_CONSTANTS, TILE

WALK_THREADS: Final = 64
_BINDINGS = {
    "bin_tiles": {"measure": "urrrwwwrr", "emit": "urrwwwwrr"},
    "bin_cells": {"measure": "urrrwww", "emit": "urrrwww"},
}


@final
class BinTiles:
    """The kernels of ``bin_tiles.wgsl`` or ``bin_cells.wgsl``: list image tiles that splats touch.

    Args:
        device: Device of the kernels.
        walk: Splats per invocation.
        panorama: Whether the image is a panorama.
        digits: How the first digits of listed tiles are counted; None to list the tiles of cells
            instead of splats, and to count none.
        tile: Edge of a tile, in pixels.
        records: Whether each splat is one record.
    """

    def __init__(
        self,
        device: Device,
        walk: int,
        *,
        panorama: bool = False,
        digits: FirstDigits | None = None,
        tile: int = TILE,
        records: bool = False,
    ) -> None:
        shader = "bin_cells" if digits is None else "bin_tiles"
        constants = {
            "THREADS": WALK_THREADS,
            "RUN": walk,
            "TILE": tile,
            "RECORDS": records,
            **COUNT_CONSTANTS,
        }
        constants |= digits.constants if digits else {}
        constants |= PANORAMA_CONSTANTS if panorama else {}
        self._measure, self._emit = (
            Kernel(device, shader, entry, (kinds,), **constants)
            for entry, kinds in _BINDINGS[shader].items()
        )

    def steps(
        self, counts: Buffer, resources: tuple[Buffer, ...], histogram: Buffer | None = None
    ) -> tuple[Step, Step]:
        """Return the dispatches that count the image tiles of each splat, then list these tiles.

        A prefix sum of the counts runs between the two.

        Args:
            counts: The frame's counts, or those of its cells.
            resources: Resources of the shader, in order.
            histogram: If digits are counted, the histogram to which they are added.
        """
        dispatch = (counts, 4 * Counts.WALK_VISIBLE_GROUPS)
        emitted = resources
        if histogram is not None:  # in place of the numbers of tiles, which only `measure` reads
            emitted = (*resources[:3], histogram, *resources[4:])
        return (
            Step(self._measure, (self._measure.bind(*resources),), dispatch),
            Step(self._emit, (self._emit.bind(*emitted),), dispatch),
        )


def touched_reference(
    mean: Float[np.ndarray, "2"],
    conic: Float[np.ndarray, "3"],
    strength: float,
    size: tuple[int, int],
    period: float = 0.0,
    tile: int = TILE,
) -> Bool[np.ndarray, "rows columns"]:
    """Return the mask of image tiles that have a pixel which a splat reaches.

    Args:
        mean: Centre of the splat, in pixels.
        conic: Inverse 2D covariance: xx, xy, yy.
        strength: Logarithm of the opacity over CULL_OPACITY.
        size: Width and height of the image, in pixels.
        period: Pixels of a full turn of a panorama; 0 for other images.
        tile: Edge of a tile, in pixels.
    """
    across, down = (-(-side // tile) for side in size)
    dx = np.arange(size[0]) + 0.5 - mean[0]
    if period:
        dx = dx - period * np.round(dx / period)
    dy = np.arange(size[1])[:, None] + 0.5 - mean[1]
    power = 0.5 * (conic[0] * dx**2 + conic[2] * dy**2) + conic[1] * dx * dy
    reached = np.zeros((down * tile, across * tile), bool)
    reached[: size[1], : size[0]] = power <= strength
    return np.asarray(reached.reshape(down, tile, across, tile).any(axis=(1, 3)))
