"""Blends cells (groups of Gaussians) in each image tile front to back, by weighted sums."""

__all__ = ["PLANES", "BlendWsr", "blend_wsr_reference"]

from collections.abc import Sequence
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float

from gsgen.contract.spec import layout
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.project.project import Projected
from gsgen.runtime.kernels.shared.kernel import Kernel, Step
from gsgen.runtime.kernels.shared.shader import FINISHED, MAX_ALPHA, TILE
from gsgen.runtime.kernels.tiles.blend_tiles import workgroup_shape

PLANES: Final = {False: 4, True: 6}
"""Numbers per pixel that farther slabs go on from, beside the image: of colours, and of depths."""


@final
class BlendWsr:
    """Blends groups of Gaussians by weighted sums: ``blend_wsr.wgsl`` or its subgroup version.

    Args:
        device: Device of the kernel.
        pick: Whether to compute depths and ids instead of colours.
        panorama: Whether the image is a panorama.
        published: Whether backgrounds count as in the method's own renderer.
        layers: Number of layers if the result is the first of them, else 0.
        first_plane: Where the numbers that slabs keep begin in the buffer of the layers' depths, or
            in one of their own, in numbers per pixel; None if there are no slabs. Ids of slabs are
            computed from arrays of ``place_splats.wgsl`` in place of colours.
    """

    def __init__(
        self,
        device: Device,
        *,
        pick: bool,
        panorama: bool = False,
        published: bool = False,
        layers: int = 0,
        first_plane: int | None = None,
    ) -> None:
        self._no_depths = device.storage("no layer depths", 16)
        together, constants = workgroup_shape(device, layers, panorama=panorama)
        self.kernel = Kernel(
            device,
            "blend_wsr_subgroups" if together else "blend_wsr",
            "blend",
            ("urrrrrrw", "w"),
            PARTS=constants["CELLS"],  # this shader means cells of Gaussians by cells
            PICK=pick,
            PUBLISHED=published,
            LAYERED=layers > 0,
            CARRIED=first_plane is not None,
            FIRST_PLANE=first_plane or 0,
            KEPT=4 + PLANES[pick] if first_plane is not None else 0,
            **constants,
        )

    def step(
        self, tiles: tuple[int, int], resources: tuple[Buffer, ...], depths: Buffer | None = None
    ) -> Step:
        """Return the dispatch that blends the Gaussians of all tiles into an image.

        Args:
            tiles: Number of tiles across and down.
            resources: Resources of the shader, in order.
            depths: Buffer of the layers' depths, or of what slabs keep; None without both.
        """
        if depths is None:
            depths = self._no_depths
        binds = (self.kernel.bind(*resources), self.kernel.bind(depths, group=1))
        return Step(self.kernel, binds, (*tiles, 1))


def blend_wsr_reference(
    splats: Projected,
    radius: Float[np.ndarray, " n"],
    cells: Sequence[tuple[slice, Bool[np.ndarray, "rows columns"]]],
    factors: tuple[float, float],
    origin: Float[np.ndarray, "2"],
    size: tuple[int, int],
) -> Float[np.ndarray, "h w 4"]:
    """Blend one splat set without background in float64: the reference of ``blend_wsr.wgsl``.

    Args:
        splats: The Gaussians of the set, drawn or not.
        radius: Radius of the circle that bounds each Gaussian, in pixels.
        cells: The Gaussians and the tiles of each cell, nearest first.
        factors: Divisor of the opacity, and the weight of the background.
        origin: Origin of the means, in pixels of the image.
        size: Width and height of the image, in pixels.
    """
    (divisor, behind), (width, height) = factors, size
    x = np.arange(width) + 0.5 - origin[0]
    y = np.arange(height)[:, None] + 0.5 - origin[1]
    through, total = np.ones((height, width)), np.zeros((height, width))
    color = np.zeros((height, width, 3))
    for members, tiles in cells:
        inside = np.kron(tiles, np.ones((TILE, TILE), bool))[:height, :width]
        entered = np.where(inside & (through >= FINISHED), through, 0)
        for i in np.flatnonzero(splats.drawn[members]) + members.start:
            dx, dy = x - splats.mean[i, 0], y - splats.mean[i, 1]
            xx, xy, yy = splats.conic[i]
            above = splats.strength[i] - 0.5 * (xx * dx**2 + yy * dy**2) - xy * dx * dy
            alpha = np.minimum(layout.CULL_OPACITY * np.exp(above), MAX_ALPHA) / divisor
            hit = (entered > 0) & (above >= 0) & (dx**2 + dy**2 <= radius[i] ** 2)
            alpha = np.where(hit, alpha, 0)
            through *= np.maximum(1 - alpha, 0)
            total += alpha * entered
            color += (alpha * entered)[..., None] * splats.color[i]
    backdrop = np.where(through < FINISHED, 0, behind * through)
    scale = np.where(total > 0, total + backdrop, 1)
    return np.concatenate([color, total[..., None]], axis=-1) / scale[..., None]
