"""Blends the splats of each image tile, front to back."""

__all__ = [
    "MIN_DILATION",
    "MIN_TRANSMITTANCE",
    "BlendTiles",
    "Layers",
    "allocate_layers",
    "workgroup_shape",
]

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer, Resource
from gsgen.runtime.kernels.shared.kernel import VEC4, Kernel, Step
from gsgen.runtime.kernels.shared.shader import TILE
from gsgen.runtime.kernels.shared.subgroups import subgroup_size

MIN_DILATION: Final = 0.25
"""Dilation, in pixels², below which opacities may underflow within four pixels of a column."""

MIN_TRANSMITTANCE: Final = 1e-4
"""Transmittance below which a pixel is finished (Kerbl et al. 2023)."""

_GPU_CELL: Final = {"LANES": 32, "CELL_WIDTH": 16, "CELL_HEIGHT": 8}
_NARROW_CELL: Final = {"LANES": 4, "CELL_WIDTH": 4, "CELL_HEIGHT": 4}  # of SwiftShader


@final
@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """Image layers with depths, which are blended among the splats, front to back.

    A pixel of a layer is a colour multiplied by its alpha, and the alpha; its depth is along +z,
    or NOWHERE or infinite where the layer is empty. A later layer is nowhere in front of an
    earlier one, and only the last may be opaque.

    Attributes:
        count: Number of layers.
        colors: Buffer of four float32 per pixel, layer by layer.
        depths: Buffer of one float32 per pixel, layer by layer. Of a scene in depth slabs, the
            light that reaches each pixel of a layer follows, for each of OUTPUTS; then what slabs
            of weighted sums keep.
        normals: Like ``colors``, with normals in camera space in place of colours; None if
            normals are not requested.
    """

    count: int
    colors: Buffer
    depths: Buffer
    normals: Buffer | None = None


def allocate_layers(
    storage: Callable[[str, int], Buffer],
    count: int,
    size: tuple[int, int],
    *,
    normal: bool,
    numbers: int = 0,
) -> Layers:
    """Allocate GPU buffers for image layers: colours, depths and normals.

    Args:
        storage: Allocates a buffer of a name and a number of bytes.
        count: Number of layers.
        size: Width and height of the image, in pixels.
        normal: Whether normals are requested.
        numbers: Numbers per pixel that depth slabs keep with the depths.
    """
    pixels = size[0] * size[1]
    return Layers(
        count,
        storage("layer colors", VEC4 * count * pixels),
        storage("layer depths", 4 * (count + numbers) * pixels),
        storage("layer normals", VEC4 * count * pixels) if normal else None,
    )


def workgroup_shape(
    device: Device, layers: int, *, panorama: bool
) -> tuple[bool, dict[str, int | float | bool]]:
    """Choose how the pixels of a tile are divided among invocations of a workgroup.

    Returns:
        Whether a tile's invocations are one subgroup that reads splats together, and the
        constants of the shader.
    """
    # A CPU's vector is as wide as half a tile, so an invocation takes two columns, top to bottom.
    # A GPU is fast with many invocations.
    columns, quads = (2, 4) if device.software else (1, 1)
    constants: dict[str, int | float | bool] = {
        "COLUMNS": columns,
        "QUADS": quads,
        "CELLS": columns * quads,
        "LANES": TILE // columns,
        "POLYNOMIAL": device.software,
        "PANORAMA": panorama,
        "LAYERS": layers,
    }
    return device.software and subgroup_size(device) == TILE // columns, constants


@final
class BlendTiles:
    """Blends splats tile by tile, by ``blend_tiles.wgsl`` or a shader that is faster on a device.

    ``blend_subgroups.wgsl`` is for CPUs whose subgroups are as wide as half a tile, and
    ``blend_staged.wgsl``, which reads splats through workgroup memory, for larger tiles and for CPUs
    with subgroups of four (SwiftShader takes 0.4 of the time).

    Args:
        device: Device of the kernel.
        pick: Whether to compute depths and ids instead of colours.
        panorama: Whether the image is a panorama.
        layers: Number of image layers among the splats.
        tile: Edge of a tile, in pixels.
        records: Whether each splat is one record.
        carried_layers: The output, from 1 on in OUTPUTS, whose pixels keep their state in the
            image between slabs; 0 if there are none. Ids of slabs are computed from arrays of
            ``place_splats.wgsl`` in place of colours.
        has_small_dilation: Whether the dilation may be below LEAST_DILATION.
        windows: Whether colours are followed by variances, as ``ProjectKernel`` writes them.

    Attributes:
        kernel: The kernel.
        shader: Name of its shader.
    """

    def __init__(
        self,
        device: Device,
        *,
        pick: bool,
        panorama: bool = False,
        layers: int = 0,
        tile: int = TILE,
        records: bool = False,
        carried_layers: int = 0,
        has_small_dilation: bool = False,
        windows: bool = False,
    ) -> None:
        is_cooperative, constants = workgroup_shape(device, layers, panorama=panorama)
        uses_narrow_cell = (
            device.software
            and not is_cooperative
            and subgroup_size(device) == _NARROW_CELL["LANES"]
        )
        self.shader = "blend_subgroups" if is_cooperative else "blend_tiles"
        if tile != TILE or uses_narrow_cell:
            self.shader = "blend_staged"
            constants |= {"TILE": tile, "COLUMNS": 1, "QUADS": 1, "CELLS": 1}
            constants |= _GPU_CELL if tile != TILE else _NARROW_CELL
        self.kernel = Kernel(
            device,
            self.shader,
            "blend",
            ("urrrrrw", "rw") if layers else ("urrrrrw",),
            PICK=pick,
            RECORDS=records,
            CARRIED=carried_layers > 0,
            CARRIED_OUTPUT=carried_layers,
            MIN_TRANSMITTANCE=MIN_TRANSMITTANCE,
            STEEP=has_small_dilation,
            WINDOWS=windows,
            MASKED=self.shader == "blend_subgroups" and not panorama,
            **constants,
        )

    def step(
        self,
        tiles: tuple[int, int],
        resources: tuple[Resource, ...],
        layers: tuple[Buffer, Buffer] | None = None,
    ) -> Step:
        """Return the dispatch that blends the Gaussians of all tiles into an image.

        Args:
            tiles: Number of tiles across and down.
            resources: Resources of the shader, in order.
            layers: Colours or normals, and depths, of the layers; None without layers.
        """
        bind_groups = [self.kernel.bind(*resources)]
        if layers is not None:
            bind_groups.append(self.kernel.bind(*layers, group=1))
        return Step(self.kernel, tuple(bind_groups), (*tiles, 1))
