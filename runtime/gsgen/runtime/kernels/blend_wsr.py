"""Blend by weighted sums: composite each tile's cells, front to back, whose Gaussians are summed."""

__all__ = ["FINISHED", "BlendWsr"]

from typing import Any, Final, final

from gsgen.runtime.device import Device
from gsgen.runtime.kernels.blend_tiles import NOWHERE
from gsgen.runtime.kernels.kernel import Kernel, Step
from gsgen.runtime.kernels.shader import ROUND

FINISHED: Final = 0.01
"""A pixel through which less light passes takes no further cell (Liu et al. 2025, their code)."""


@final
class BlendWsr:
    """``blend_wsr.wgsl``.

    Args:
        device: Where it runs.
        pick: Whether to make depths and ids instead of colours.
        panorama: Whether the image is one.
        published: Whether backgrounds count as in the method's own renderer.
        layers: How many layers there are, if the image is the first of them.
    """

    def __init__(
        self,
        device: Device,
        pick: bool,
        panorama: bool = False,
        published: bool = False,
        layers: int = 0,
    ) -> None:
        columns, quads = (2, 4) if device.software else (1, 1)  # as in blend_tiles.py
        self.kernel = Kernel(
            device,
            "blend_wsr",
            "blend",
            ("urrrrrrw", "w") if layers else ("urrrrrrw",),
            COLUMNS=columns,
            QUADS=quads,
            PARTS=columns * quads,
            PICK=pick,
            PUBLISHED=published,
            FINISHED=FINISHED,
            **(ROUND if panorama else {}),
            **({"LAYERS": layers, "LAYERED": 1, "NOWHERE": NOWHERE} if layers else {}),
        )

    def step(
        self, tiles: tuple[int, int], resources: tuple[Any, ...], depths: Any = None
    ) -> Step:
        """Return the blending of an image.

        Args:
            tiles: How many there are across and down.
            resources: What ``blend_wsr.wgsl`` binds, in its order.
            depths: Of the layers, where there are any.
        """
        binds = [self.kernel.bind(*resources)]
        if depths is not None:
            binds.append(self.kernel.bind(depths, group=1))
        return Step(self.kernel, tuple(binds), (*tiles, 1))
