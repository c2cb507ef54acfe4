"""Blends cells (groups of Gaussians) in each image tile front to back, by weighted sums."""

__all__ = ["MIN_WSR_TRANSMITTANCE", "PLANE_COUNT_BY_NORMAL", "BlendWsr"]

from typing import Final, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.kernel import Kernel, Step
from gsgen.runtime.kernels.tiles.blend_tiles import workgroup_shape

MIN_WSR_TRANSMITTANCE: Final = 0.01
"""Transmittance below which a pixel takes no further cell (Liu et al. 2025, their code)."""

PLANE_COUNT_BY_NORMAL: Final = {False: 4, True: 6}
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
        self._placeholder_depths = device.storage("no layer depths", 16)
        is_cooperative, constants = workgroup_shape(device, layers, panorama=panorama)
        self.kernel = Kernel(
            device,
            "blend_wsr_subgroups" if is_cooperative else "blend_wsr",
            "blend",
            ("urrrrrrw", "w"),
            PARTS=constants["CELLS"],  # this shader means cells of Gaussians by cells
            PICK=pick,
            PUBLISHED=published,
            FINISHED=MIN_WSR_TRANSMITTANCE,
            LAYERED=layers > 0,
            CARRIED=first_plane is not None,
            FIRST_PLANE=first_plane or 0,
            KEPT=4 + PLANE_COUNT_BY_NORMAL[pick] if first_plane is not None else 0,
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
            depths = self._placeholder_depths
        bind_groups = (self.kernel.bind(*resources), self.kernel.bind(depths, group=1))
        return Step(self.kernel, bind_groups, (*tiles, 1))
