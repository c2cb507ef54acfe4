"""Blend: composite each tile's splats, front to back."""

__all__ = ["BlendTiles"]

from typing import Any, final

from gsgen.runtime.device import Device
from gsgen.runtime.kernels.kernel import Kernel, Step


@final
class BlendTiles:
    """``blend_tiles.wgsl``."""

    def __init__(self, device: Device) -> None:
        self.kernel = Kernel(device, "blend_tiles", "blend", ("urrrrrw",))

    def step(self, tiles: tuple[int, int], *resources: Any) -> Step:
        """Return the blending of an image of so many tiles across and down."""
        return Step(self.kernel, (self.kernel.bind(*resources),), (*tiles, 1))
