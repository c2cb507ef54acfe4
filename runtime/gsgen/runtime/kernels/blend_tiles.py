"""Blend: composite each tile's splats, front to back."""

__all__ = ["BlendTiles"]

from typing import Any, final

from gsgen.runtime.device import Device
from gsgen.runtime.kernels.kernel import Kernel, Step


@final
class BlendTiles:
    """``blend_tiles.wgsl``.

    Args:
        device: Where it runs.
        pick: Whether to make depths and ids instead of colours.
    """

    def __init__(self, device: Device, pick: bool) -> None:
        # A CPU's vector is as wide as half a tile: one invocation takes two columns, top to
        # bottom. A GPU wants many invocations.
        columns, quads = (2, 4) if device.software else (1, 1)
        self.kernel = Kernel(
            device,
            "blend_tiles",
            "blend",
            ("urrrrrw",),
            COLUMNS=columns,
            QUADS=quads,
            CELLS=columns * quads,
            PICK=pick,
        )

    def step(self, tiles: tuple[int, int], resources: tuple[Any, ...]) -> Step:
        """Return the blending of an image.

        Args:
            tiles: How many there are across and down.
            resources: What ``blend_tiles.wgsl`` binds, in its order.
        """
        return Step(self.kernel, (self.kernel.bind(*resources),), (*tiles, 1))
