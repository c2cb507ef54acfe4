"""What decides the kernels of a frame plan: the images that it draws, and the method."""

__all__ = ["Backgrounds", "DepthSort", "Dilation", "ImageSpec", "RasterMethod", "Rasteriser"]

from dataclasses import dataclass
from typing import Literal, final

from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.kernels.project.project import Eyes
from gsgen.runtime.kernels.project.projections import Projection, projection_of
from gsgen.runtime.kernels.tiles.blend_tiles import MIN_DILATION
from gsgen.runtime.renderer.slabs import WITHOUT_SLABS, SlabSizes
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import COLOR_OUTPUT_ONLY, Output

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
        eyes: 2 if a right eye's images follow those of a left one, by one sort.
    """

    size: tuple[int, int]
    outputs: frozenset[Output] = frozenset(COLOR_OUTPUT_ONLY)
    projection: Projection = "plane"
    dilation: Dilation = "usual"
    eyes: Eyes = 1

    @classmethod
    def of(cls, camera: Camera, outputs: frozenset[Output], eyes: Eyes = 1) -> "ImageSpec":
        """Return the images of a camera, or of two eyes."""
        return cls(
            size=(camera.width, camera.height),
            outputs=outputs,
            projection=projection_of(camera),
            dilation="small" if camera.dilation < MIN_DILATION else "usual",
            eyes=eyes,
        )

    def require_meshes(self) -> None:
        """Raise if meshes cannot be drawn in the images: their kernels know no lenses."""
        if self.projection in ("distorted", "fisheye"):
            lens = "a fisheye" if self.projection == "fisheye" else "a lens with distortion"
            raise SceneInvalid(
                f"is {lens}, expected a camera without one: the scene has meshes",
                where="camera",
                hint="Leave the meshes out, or draw them through a pinhole or a panorama.",
            )

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
