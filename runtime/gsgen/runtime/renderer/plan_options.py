"""What decides the kernels of a frame plan: the images that it draws, and the method."""

__all__ = [
    "Backgrounds",
    "DepthSort",
    "Dilation",
    "ImageSpec",
    "Projection",
    "RasterMethod",
    "Rasteriser",
]

from dataclasses import dataclass
from typing import Literal, final

from gsgen.runtime.renderer.slabs import WITHOUT_SLABS, SlabSizes
from gsgen.runtime.scene.frame import COLOR_OUTPUT_ONLY, Output

Projection = Literal["plane", "panorama"]
"""Where splats are projected to; a panorama draws a splat up to three times, around its seam."""

Dilation = Literal["usual", "small"]
"""Whether a camera's dilation may be below LEAST_DILATION, where falloffs are steep."""

Rasteriser = Literal["tiles", "quads"]
"""What blends colours: compute kernels tile by tile, or the hardware, a quad for each splat."""

DepthSort = Literal["by key", "deep"]
"""How splats are sorted: by 32-bit depths, or also by remainders if very many depths are equal."""

Backgrounds = Literal["composed", "published"]
"""How weighted sums count backgrounds: like a layer, or as the method's own renderer does."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ImageSpec:
    """The images that a plan draws.

    Attributes:
        size: Width and height, in pixels.
        outputs: Requested outputs.
        projection: Where splats are projected to.
        dilation: The least dilation of cameras.
    """

    size: tuple[int, int]
    outputs: frozenset[Output] = frozenset(COLOR_OUTPUT_ONLY)
    projection: Projection = "plane"
    dilation: Dilation = "usual"

    @property
    def panorama(self) -> bool:
        """Whether the images are panoramas."""
        return self.projection == "panorama"

    @property
    def pixels(self) -> int:
        """Number of pixels of an image."""
        return self.size[0] * self.size[1]

    def tiles(self, edge: int) -> tuple[int, int]:
        """Return the number of tiles across and down, of ``edge`` pixels each way."""
        return -(-self.size[0] // edge), -(-self.size[1] // edge)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RasterMethod:
    """How a plan draws its images.

    Attributes:
        pair_capacity: Most pairs of a splat, or of a cell, and a tile.
        rasteriser: What blends the colours.
        sort: How splats are sorted by depth.
        backgrounds: How weighted sums count backgrounds.
        slabs: Most splats that are drawn at once, if the scene may have more.
    """

    pair_capacity: int
    rasteriser: Rasteriser = "tiles"
    sort: DepthSort = "by key"
    backgrounds: Backgrounds = "composed"
    slabs: SlabSizes = WITHOUT_SLABS
