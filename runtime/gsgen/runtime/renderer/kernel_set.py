"""The rendering kernels of a device, each compiled when a frame first needs it."""

__all__ = ["RECORD", "Kernels", "WeightedKernels"]

from collections.abc import Callable
from functools import cache
from typing import Final, final

from gsgen.runtime.gpu.device import MOST_GROUPS, Device
from gsgen.runtime.kernels.project.cull_slots import CullSlots
from gsgen.runtime.kernels.project.normals import NormalsKernel
from gsgen.runtime.kernels.project.place_splats import PlaceSplats
from gsgen.runtime.kernels.project.project import ProjectKernel
from gsgen.runtime.kernels.project.project_cells import ProjectCells, SlabCells
from gsgen.runtime.kernels.project.tally_keys import TallyKeys
from gsgen.runtime.kernels.raster.draw_meshes import DrawMeshes
from gsgen.runtime.kernels.raster.draw_quads import DrawQuads
from gsgen.runtime.kernels.shared.kernel import VEC4
from gsgen.runtime.kernels.shared.shader import TILE
from gsgen.runtime.kernels.sort.scan import Scan
from gsgen.runtime.kernels.sort.sort import KEY_BITS, RadixSort, SortConfig, cut_for
from gsgen.runtime.kernels.tiles.bin_tiles import WALK_THREADS, BinTiles
from gsgen.runtime.kernels.tiles.blend_tiles import BlendTiles
from gsgen.runtime.kernels.tiles.blend_wsr import BlendWsr
from gsgen.runtime.kernels.tiles.list_tiles import ListTiles
from gsgen.runtime.kernels.tiles.tile_ranges import RANGE_BLOCK, TileRanges
from gsgen.runtime.renderer.depth_sort import DepthOrder

RECORD: Final = 2 * VEC4
"""Bytes of a splat that is one record; its colour is elsewhere."""


@final
class WeightedKernels:
    """The kernels of weighted-sum rendering, each compiled when it is first needed.

    Args:
        device: Device of the kernels.
        cut: Configuration of the sort.
        scan: The scan; shared with the rest of the plan, like the next three.
        sort: The radix sort.
        order: The depth sort.
        ranges: The tile ranges.
        tile_bits: Returns the number of key bits that sort tile indices up to a given one.
    """

    def __init__(
        self,
        device: Device,
        cut: SortConfig,
        scan: Scan,
        sort: RadixSort,
        order: DepthOrder,
        ranges: TileRanges,
        tile_bits: Callable[[int], int],
    ) -> None:
        self.tile_bits = tile_bits
        self.cut, self.scan, self.sort = cut, scan, sort
        self.order, self.ranges = order, ranges
        self.project = cache(
            lambda half, words, panorama, slab=None: ProjectKernel(
                device, words, half=half, panorama=panorama, weighted=True, slab=slab
            )
        )
        self.cells = cache(lambda panorama: ProjectCells(device, panorama=panorama))
        self.slab_cells = cache(lambda panorama: SlabCells(device, panorama=panorama))
        self.bin = cache(lambda panorama: BinTiles(device, cut.walk, panorama=panorama))
        self.blend = cache(
            lambda pick, panorama, published, layers, first_plane=None: BlendWsr(
                device,
                pick=pick,
                panorama=panorama,
                published=published,
                layers=layers,
                first_plane=first_plane,
            )
        )
        self.normals = cache(lambda placed=False: NormalsKernel(device, placed=placed))


@final
class Kernels:
    """The rendering kernels of a device, each compiled when it is first needed.

    Args:
        device: Device of the kernels.
        one_shape: Whether a plan's steps are the same for all sizes of scenes and images, except
            that larger images need more passes of the tile sort.
        cut: How work is divided among invocations; :func:`cut_for` by default.

    Attributes:
        lists: Whether splats are listed by tile without a sort of pairs.
    """

    def __init__(
        self, device: Device, *, one_shape: bool = False, cut: SortConfig | None = None
    ) -> None:
        self.cut, self._one_shape = cut or cut_for(device), one_shape
        self._largest_binding = device.largest_binding
        self.scan = Scan(
            device,
            self.cut.block,
            WALK_THREADS * self.cut.walk,
            RANGE_BLOCK,
            always_in_blocks=one_shape,
        )
        self.sort = RadixSort(device, self.cut, self.scan)
        self.bin = cache(
            lambda panorama, records, digits: BinTiles(
                device,
                self.cut.walk,
                panorama=panorama,
                digits=digits,
                tile=self.cut.tile,
                records=records,
            )
        )
        self.lists = device.software and self.cut.tile == TILE and not one_shape
        self.list = cache(lambda panorama: ListTiles(device, panorama=panorama))
        self.ranges = TileRanges(device)
        self.blend = cache(
            lambda pick, panorama, layers, records, carried=0, steep=False, color=False: BlendTiles(
                device,
                pick=pick,
                panorama=panorama,
                layers=layers,
                tile=self.cut.tile,
                records=records,
                carried=carried,
                steep=steep,
                windows=color and self.lists,
            )
        )
        self.project = cache(
            lambda half, words, panorama, packed, slot_rows, records, slab=None: ProjectKernel(
                device,
                words,
                half=half,
                panorama=panorama,
                packed=packed,
                slot_rows=slot_rows,
                tile=self.cut.tile,
                records=records,
                slab=slab,
                windows=self.lists,
                digits=self.sort.first_digits(KEY_BITS) if self.counts_keys(slab) else None,
            )
        )
        self.tally = cache(lambda: TallyKeys(device))
        self.place = cache(lambda arranged: PlaceSplats(device, arranged=arranged))
        self.cull_slots = cache(
            lambda slot_rows, panorama, keys_only=False: CullSlots(
                device, slot_rows, panorama=panorama, keys_only=keys_only
            )
        )
        self.normals = cache(
            lambda packed, slot_rows, placed=False: NormalsKernel(
                device, packed=packed, slot_rows=slot_rows, placed=placed
            )
        )
        self.order = DepthOrder(device, self.cut, self.sort)
        self.weighted = cache(
            lambda: WeightedKernels(
                device, self.cut, self.scan, self.sort, self.order, self.ranges, self.tile_bits
            )
        )
        self.quads = cache(
            lambda tested, panorama, records: DrawQuads(
                device, tested=tested, panorama=panorama, records=records
            )
        )
        self.meshes = cache(lambda panorama: DrawMeshes(device, panorama=panorama))

    def counts_keys(self, slab: str | None = None) -> bool:
        """Return whether projection counts the first digits of depth keys; not those of a slab."""
        return self.cut.staged and slab is None

    @property
    def most_binned(self) -> int:
        """The most splats that one GPU dispatch can assign to tiles."""
        return MOST_GROUPS * WALK_THREADS * self.cut.walk

    def records(self, gaussians: int) -> bool:
        """Return whether all projected splats are stored as structs in one GPU buffer."""
        is_possible = self.cut.tile != TILE and not self._one_shape
        return is_possible and RECORD * gaussians <= self._largest_binding

    def tile_bits(self, last: int) -> int:
        """Return the number of sort-key bits for tile indices up to ``last``."""
        bits = max(1, last.bit_length())
        digit = self.cut.digit_bits
        return -(-bits // digit) * digit if self._one_shape else bits
