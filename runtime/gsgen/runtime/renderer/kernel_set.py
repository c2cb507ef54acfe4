"""The rendering kernels of a device, each compiled when a frame first needs it."""

__all__ = ["RECORD_BYTES", "Kernels"]

from collections.abc import Callable
from typing import Any, Final, Literal, TypeVar, final

from gsgen.runtime.gpu.device import MAX_WORKGROUPS, Device
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.kernels.project.cull_slots import CullSlots
from gsgen.runtime.kernels.project.normals import NormalsKernel
from gsgen.runtime.kernels.project.place_splats import PlaceSplatsKernel
from gsgen.runtime.kernels.project.project import Eyes, ProjectKernel
from gsgen.runtime.kernels.project.project_cells import ProjectCells, SlabCells
from gsgen.runtime.kernels.project.projections import Projection
from gsgen.runtime.kernels.project.tally_keys import CountKeysKernel
from gsgen.runtime.kernels.raster.draw_meshes import DrawMeshes
from gsgen.runtime.kernels.raster.draw_quads import DrawQuads
from gsgen.runtime.kernels.shared.first_digits import FirstDigits
from gsgen.runtime.kernels.shared.kernel import VEC4
from gsgen.runtime.kernels.shared.shader import TILE
from gsgen.runtime.kernels.sort.scan import Scan
from gsgen.runtime.kernels.sort.sort import KEY_BITS, RadixSort, SortConfig, sort_config_for
from gsgen.runtime.kernels.tiles.bin_tiles import WALK_THREADS, BinTiles
from gsgen.runtime.kernels.tiles.blend_tiles import BlendTiles
from gsgen.runtime.kernels.tiles.blend_wsr import BlendWsr
from gsgen.runtime.kernels.tiles.list_tiles import ListTiles
from gsgen.runtime.kernels.tiles.tile_ranges import RANGE_BLOCK, TileRanges
from gsgen.runtime.renderer.depth_sort import DepthOrder
from gsgen.runtime.renderer.placed_pages import slot_rows
from gsgen.runtime.scene.frame import OUTPUTS, Output

RECORD_BYTES: Final = 2 * VEC4
"""Bytes of a splat that is one record; its colour is elsewhere."""

SlabPart = Literal["keys", "splats"]
"""What projection computes for a slab: the keys of all rows, or the splats of the slab's rows."""

_Kernel = TypeVar("_Kernel")


@final
class Kernels:
    """The rendering kernels of a device, each compiled when it is first needed.

    Args:
        device: Device of the kernels.
        is_single_shape: Whether a plan's steps are the same for all sizes of scenes and images, except
            that larger images need more passes of the tile sort.
        sort_config: How work is divided among invocations; :func:`sort_config_for` by default.

    Attributes:
        device: Device of the kernels.
        sort_config: How work is divided among invocations.
        lists: Whether splats are listed by tile without a sort of pairs.
        scan: The prefix sums.
        sort: The radix sort.
        order: The depth sort.
        ranges: Finds the pairs of each tile.
    """

    def __init__(
        self,
        device: Device,
        *,
        is_single_shape: bool = False,
        sort_config: SortConfig | None = None,
    ) -> None:
        self.device, self._is_single_shape = device, is_single_shape
        self.sort_config = sort_config or sort_config_for(device)
        self._kernel_cache: dict[tuple[object, ...], Any] = {}
        walk_block = WALK_THREADS * self.sort_config.walk_rows
        self.scan = Scan(
            device,
            self.sort_config.block,
            walk_block,
            RANGE_BLOCK,
            always_in_blocks=is_single_shape,
        )
        self.sort = RadixSort(device, self.sort_config, self.scan)
        self.order = DepthOrder(device, self.sort_config, self.sort)
        self.ranges = TileRanges(device)
        self.lists = device.software and self.sort_config.tile == TILE and not is_single_shape

    def _cached_kernel(
        self, kind: Callable[..., _Kernel], *arguments: object, **keyword_arguments: object
    ) -> _Kernel:
        """Return a kernel of the device, the same one for the same arguments."""
        key = (kind, arguments, *keyword_arguments.items())
        if key not in self._kernel_cache:
            self._kernel_cache[key] = kind(self.device, *arguments, **keyword_arguments)
        kernel: _Kernel = self._kernel_cache[key]
        return kernel

    def cull_slots(
        self, page: Page, *, projection: Projection, keys_only: bool = False
    ) -> CullSlots:
        """Return the kernel that lists the slots in view of a pool's page."""
        return self._cached_kernel(
            CullSlots, slot_rows(page), projection=projection, keys_only=keys_only
        )

    def project(
        self,
        page: Page,
        *,
        projection: Projection,
        records: bool = False,
        slab: SlabPart | None = None,
        eyes: Eyes = 1,
    ) -> ProjectKernel:
        """Return the kernel that projects the rows of a page to splats that are sorted."""
        return self._cached_kernel(
            ProjectKernel,
            page.appearance_stride,
            is_half=page.is_half,
            projection=projection,
            packed=page.packed,
            slot_rows=slot_rows(page),
            tile=self.sort_config.tile,
            records=records,
            slab=slab,
            windows=self.lists,
            digits=self.sort.first_digits(KEY_BITS) if self.counts_keys and not slab else None,
            eyes=eyes,
        )

    def project_weighted(
        self, page: Page, *, projection: Projection, slab: SlabPart | None = None
    ) -> ProjectKernel:
        """Return the kernel that projects the rows of a page for weighted sums."""
        return self._cached_kernel(
            ProjectKernel,
            page.appearance_stride,
            is_half=page.is_half,
            projection=projection,
            weighted=True,
            slab=slab,
        )

    def project_cells(self, *, projection: Projection) -> ProjectCells:
        """Return the kernel that projects cells (groups of Gaussians)."""
        return self._cached_kernel(ProjectCells, projection=projection)

    def slab_cells(self, *, projection: Projection) -> SlabCells:
        """Return the kernels that project the cells of a slab."""
        return self._cached_kernel(SlabCells, projection=projection)

    def normals(self, page: Page, *, placed: bool = False) -> NormalsKernel:
        """Return the kernel that computes the normals of a page; of a slab's rows if ``placed``."""
        return self._cached_kernel(
            NormalsKernel, packed=page.packed, slot_rows=slot_rows(page), placed=placed
        )

    def tally(self) -> CountKeysKernel:
        """Return the kernel that counts sort keys."""
        return self._cached_kernel(CountKeysKernel)

    def place(self, *, is_reordered: bool) -> PlaceSplatsKernel:
        """Return the kernels that index the rows of a slab."""
        return self._cached_kernel(PlaceSplatsKernel, is_reordered=is_reordered)

    def bin_tiles(self, *, panorama: bool, records: bool, digits: FirstDigits) -> BinTiles:
        """Return the kernels that list the tiles of splats."""
        return self._cached_kernel(
            BinTiles,
            self.sort_config.walk_rows,
            panorama=panorama,
            digits=digits,
            tile=self.sort_config.tile,
            records=records,
        )

    def bin_cells(self, *, panorama: bool) -> BinTiles:
        """Return the kernels that list the tiles of cells."""
        return self._cached_kernel(BinTiles, self.sort_config.walk_rows, panorama=panorama)

    def list_tiles(self, *, panorama: bool) -> ListTiles:
        """Return the kernels that list splats by tile without a sort of pairs."""
        return self._cached_kernel(ListTiles, panorama=panorama)

    def blend(
        self,
        output: Output,
        *,
        panorama: bool,
        layers: int,
        records: bool,
        has_small_dilation: bool,
        carried_layers: bool,
    ) -> BlendTiles:
        """Return the kernel that blends an output; ``carried_layers`` says that slabs go on from it."""
        return self._cached_kernel(
            BlendTiles,
            pick=output == "depth",
            panorama=panorama,
            layers=layers,
            tile=self.sort_config.tile,
            records=records,
            carried_layers=1 + OUTPUTS.index(output) if carried_layers else 0,
            has_small_dilation=has_small_dilation,
            windows=output == "color" and self.lists,
        )

    def blend_wsr(
        self,
        *,
        pick: bool,
        panorama: bool,
        published: bool = False,
        layers: int = 0,
        first_plane: int | None = None,
    ) -> BlendWsr:
        """Return the kernel that blends weighted sums; arguments are those of the kernel."""
        return self._cached_kernel(
            BlendWsr,
            pick=pick,
            panorama=panorama,
            published=published,
            layers=layers,
            first_plane=first_plane,
        )

    def quads(self, *, has_depth_test: bool, panorama: bool, records: bool) -> DrawQuads:
        """Return what draws quads; ``has_depth_test`` against the depths of meshes."""
        return self._cached_kernel(
            DrawQuads, has_depth_test=has_depth_test, panorama=panorama, records=records
        )

    def meshes(self, *, panorama: bool) -> DrawMeshes:
        """Return what draws meshes."""
        return self._cached_kernel(DrawMeshes, panorama=panorama)

    @property
    def counts_keys(self) -> bool:
        """Whether projection counts the first digits of depth keys; it never counts those of slabs."""
        return self.sort_config.is_staged

    @property
    def max_binned_splats(self) -> int:
        """The most splats that one GPU dispatch can assign to tiles."""
        return MAX_WORKGROUPS * WALK_THREADS * self.sort_config.walk_rows

    def records(self, gaussians: int) -> bool:
        """Return whether all projected splats are stored as structs in one GPU buffer."""
        can_use_records = self.sort_config.tile != TILE and not self._is_single_shape
        return can_use_records and RECORD_BYTES * gaussians <= self.device.largest_binding

    def tile_bits(self, last: int) -> int:
        """Return the number of sort-key bits for tile indices up to ``last``."""
        bits = max(1, last.bit_length())
        digit = self.sort_config.digit_bits
        return -(-bits // digit) * digit if self._is_single_shape else bits
