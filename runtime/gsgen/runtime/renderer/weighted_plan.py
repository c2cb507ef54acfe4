"""The part of a frame's recorded GPU work that draws splat sets by weighted sums.

Only cells are sorted and listed per tile, and their Gaussians are looked up through them. A Gaussian
needs neither sort keys nor pairs of its own.
"""

__all__ = ["WeightedKernels", "WeightedPart"]

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import final

import numpy as np
from jaxtyping import Shaped

from gsgen.contract.spec import layout
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.kernels.project.normals import NormalsKernel
from gsgen.runtime.kernels.project.project import PAGE, ProjectKernel, page_uniform
from gsgen.runtime.kernels.project.project_cells import ProjectCells
from gsgen.runtime.kernels.shared import counts as counting
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import VEC4, Step
from gsgen.runtime.kernels.shared.shader import TILE
from gsgen.runtime.kernels.sort.scan import Scan
from gsgen.runtime.kernels.sort.sort import Columns, RadixSort, SortConfig
from gsgen.runtime.kernels.tiles.bin_tiles import BinTiles
from gsgen.runtime.kernels.tiles.blend_tiles import Layers
from gsgen.runtime.kernels.tiles.blend_wsr import BlendWsr
from gsgen.runtime.kernels.tiles.tile_ranges import TileRanges
from gsgen.runtime.renderer.depth_sort import DepthOrder
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Output
from gsgen.runtime.scene.scene import SplatSet


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
            lambda half, words, panorama: ProjectKernel(
                device, words, half=half, panorama=panorama, weighted=True
            )
        )
        self.cells = cache(lambda panorama: ProjectCells(device, panorama=panorama))
        self.bin = cache(lambda panorama: BinTiles(device, cut.walk, panorama=panorama))
        self.blend = cache(
            lambda pick, panorama, published, layers: BlendWsr(
                device, pick=pick, panorama=panorama, published=published, layers=layers
            )
        )
        self.normals = cache(lambda: NormalsKernel(device))


@final
class WeightedPart:
    """GPU buffers and dispatches of a frame that draw splat sets by weighted-sum rendering.

    Args:
        device: Device of the buffers.
        kernels: Kernels of the device.
        placed: Pages of weighted sets.
        size: Width and height of the image, in pixels.
        panorama: Whether the image is a panorama.
        outputs: Requested outputs.
        pair_capacity: Most pairs of a cell and a tile.
        frames: Uniforms of the frame with the background and without it.
        layers: Layers whose first receives the result; None if the result is the image.
        published: Whether backgrounds count as in the method's own renderer.
        deep: Whether the depth sort is deep, because very many depths share a key.

    Attributes:
        stages: Steps of a frame, by stage.
        buffers: Buffers of the part, by name.
        images: Image buffers, by output; empty if the result is a layer.
        counts: Counts of cells, of their pairs and of drawn Gaussians.
        inputs: The uniforms that :meth:`write` writes, and the counts, by name.
        clears: Buffers whose bytes are zero at the start of a frame, as in a plan.
    """

    def __init__(
        self,
        device: Device,
        kernels: WeightedKernels,
        placed: Sequence[tuple[SplatSet, Page]],
        size: tuple[int, int],
        outputs: frozenset[Output],
        pair_capacity: int,
        frames: tuple[Buffer, Buffer],
        layers: Layers | None,
        *,
        panorama: bool,
        published: bool,
        deep: bool,
    ) -> None:
        self._device, self._kernels = device, kernels
        self._size, self._panorama, self._published = size, panorama, published
        self._frame, self._bare_frame = frames
        self._layers, self._deep = layers, deep
        self._tiles = (-(-size[0] // TILE), -(-size[1] // TILE))
        self.buffers: dict[str, Buffer] = {}
        self.images: dict[str, Buffer] = {}
        self._pair_capacity = pair_capacity
        self._cells = sum(_cells(page) for _, page in _sets(placed))
        self.counts = self._storage("counts of cells", counting.BYTES, extra="INDIRECT")
        device.write(self.counts, counting.initial(self._cells, pair_capacity))
        self._ranges = self._storage("ranges of cells", 8 * self._tiles[0] * self._tiles[1])
        self._slots = device.uniform("pages with cells", PAGE.itemsize * len(placed))
        self._cell_slots = device.uniform("sets of cells", PAGE.itemsize * len(placed))
        self.inputs = {"pages": self._slots, "sets": self._cell_slots, "counts": self.counts}
        self.clears: list[tuple[Buffer, int, int | None]] = [
            (self._ranges, 0, None),
            (self.counts, 4 * Counts.DRAWN, 12),  # to UNSORTED
        ]
        self.stages = self._record(placed, outputs)

    def _storage(self, name: str, size: int, *, extra: str = "") -> Buffer:
        self.buffers[name] = self._device.storage(name, size, extra=extra)
        return self.buffers[name]

    def _columns(self, name: str, length: int) -> Columns:
        return Columns(
            self._storage(f"keys of {name}", 4 * length),
            self._storage(f"values of {name}", 4 * length),
        )

    def _record(
        self, placed: Sequence[tuple[SplatSet, Page]], outputs: frozenset[Output]
    ) -> dict[str, list[Step]]:
        n = sum(page.capacity for _, page in placed)
        keys = self._storage("keys of weighted", 4 * n)
        shapes, weights, colors = (
            self._storage(f"weighted {name}", VEC4 * n) for name in ("shapes", "weights", "colors")
        )
        columns = (self._columns("cells a", self._cells), self._columns("cells b", self._cells))
        lows = self._storage("lows of cells", 4 * self._cells)
        circles = self._storage("circles of cells", VEC4 * self._cells)
        spans = self._storage("spans of cells", VEC4 * self._cells)
        stages = {
            "project weighted": self._project(placed, (keys, shapes, weights, colors)),
            "project cells": self._project_cells(
                placed, (columns[0].keys, circles, spans, keys, self.counts, lows)
            ),
        }
        stages["sort cells"], order = self._sort(columns, lows)
        pairs = [self._columns(f"pairs of cells {side}", self._pair_capacity) for side in "ab"]
        stages["bin cells"] = self._bin(order, circles, pairs[0])
        stages["group cells"], members = self._group(pairs)
        known = (self._ranges, members, spans, shapes, weights)
        if "color" in outputs or self._layers is not None:
            stages["sum"] = [self._blend("color", (*known, colors))]
        if "depth" in outputs and self._layers is None:
            stages["sum depth"] = [self._blend("depth", (*known, colors), pick=True)]
        if "normal" in outputs:
            normals = self._storage("weighted normals", VEC4 * n)
            stages["project weighted"] += self._normals(placed, keys, normals)
            stages["sum normal"] = [self._blend("normal", (*known, normals))]
        return stages

    def _project(
        self, placed: Sequence[tuple[SplatSet, Page]], outputs: tuple[Buffer, ...]
    ) -> list[Step]:
        recorded = []
        for slot, (_, page) in enumerate(placed):
            kernel = self._kernels.project(page.half, page.stride, self._panorama)
            bound = (self._frame, *outputs)
            recorded.append(kernel.step(bound, self._slots, slot, page, page.cells))
        return recorded

    def _project_cells(
        self, placed: Sequence[tuple[SplatSet, Page]], outputs: tuple[Buffer, ...]
    ) -> list[Step]:
        kernel, bound = self._kernels.cells(self._panorama), (self._frame, *outputs)
        return [
            kernel.step(bound, self._cell_slots, slot, page.cells, _cells(page))
            for slot, (_, page) in enumerate(_sets(placed))
        ]

    def _normals(
        self, placed: Sequence[tuple[SplatSet, Page]], keys: Buffer, normals: Buffer
    ) -> list[Step]:
        kernel = self._kernels.normals()
        return [
            kernel.step(keys, normals, self._slots, slot, page)
            for slot, (_, page) in enumerate(placed)
        ]

    def _sort(self, columns: tuple[Columns, Columns], lows: Buffer) -> tuple[list[Step], Buffer]:
        """Return GPU dispatches that sort groups of Gaussians by depth, and the sorted buffer."""
        n = self._cells
        spare = self._storage("keys of cells c", 4 * n) if self._deep else None
        return self._kernels.order.steps(n, self.counts, columns, lows, None, spare)

    def _bin(self, order: Buffer, circles: Buffer, pairs: Columns) -> list[Step]:
        walk = self._kernels.cut.walk
        run_pairs = self._storage("run pairs of cells", 4 * -(-self._cells // walk))
        measure, emit = self._kernels.bin(self._panorama).steps(
            self.counts, (self._frame, self.counts, order, circles, run_pairs, *pairs)
        )
        add = self._kernels.scan.steps(
            self.counts, run_pairs, source=Counts.VISIBLE, block=walk, total=Counts.PAIRS
        )
        return [measure, *add, emit]

    def _group(self, pairs: list[Columns]) -> tuple[list[Step], Buffer]:
        """Return GPU dispatches that sort pairs of Gaussian group and tile, and their buffer."""
        bits = self._kernels.tile_bits(self._tiles[0] * self._tiles[1] - 1)
        steps, side = self._kernels.sort.steps(
            self.counts,
            self._kernels.sort.histograms(self._pair_capacity, bits),
            pairs,
            bits=bits,
            source=Counts.PAIRS,
            groups=Counts.SORT_PAIRS_GROUPS,
        )
        mark = self._kernels.ranges.step(self.counts, pairs[side].keys, self._ranges)
        return [*steps, mark], pairs[side].values

    def _blend(self, name: str, resources: tuple[Buffer, ...], *, pick: bool = False) -> Step:
        if self._layers is not None:
            kernel = self._kernels.blend(False, self._panorama, False, self._layers.count)
            image = self._layers.normals if name == "normal" else self._layers.colors
            bound = (self._bare_frame, *resources, image)
            return kernel.step(self._tiles, bound, self._layers.depths)
        pixels = self._size[0] * self._size[1]
        self.images[name] = self._storage(f"{name} image", VEC4 * pixels)
        frame = self._frame if name == "color" else self._bare_frame
        kernel = self._kernels.blend(pick, self._panorama, self._published, 0)
        return kernel.step(self._tiles, (frame, *resources, self.images[name]))

    def write(self, placed: Sequence[tuple[SplatSet, Page]], camera: Camera) -> None:
        """Write the uniform buffers of a frame for weighted-sum rendering of splat sets."""
        slots, base = np.zeros(len(placed), PAGE), 0
        cell_slots, cell_base, number = np.zeros(len(placed), PAGE), 0, 0
        for slot, (splat_set, page) in enumerate(placed):
            if page.first == 0:
                live = -(-splat_set.data.count // splat_set.data.per_cell)
                uniform = page_uniform(splat_set, camera, cell_base, _cells(page), live)
                cell_slots[number] = _weighing(uniform, splat_set)
                cell_slots[number]["first_gaussian"] = base
                cell_base, number = cell_base + _cells(page), number + 1
            live = min(max(splat_set.data.count - page.first, 0), page.capacity)
            uniform = page_uniform(splat_set, camera, base, page.capacity, live)
            slots[slot] = _weighing(uniform, splat_set)
            slots[slot]["first_row"] = page.first
            base += page.capacity
        self._device.write(self._slots, slots)
        self._device.write(self._cell_slots, cell_slots)


def _sets(placed: Sequence[tuple[SplatSet, Page]]) -> Iterator[tuple[SplatSet, Page]]:
    """Yield each splat set drawn by weighted sums, with the first of its pages (GPU buffers)."""
    return ((splat_set, page) for splat_set, page in placed if page.first == 0)


def _cells(page: Page) -> int:
    """Return the number of cells (groups of Gaussians) of the splat set in a page (GPU buffers)."""
    return 0 if page.cells is None else page.cells.size // (4 * layout.ROW)


def _weighing(uniform: Shaped[np.ndarray, ""], splat_set: SplatSet) -> Shaped[np.ndarray, ""]:
    """Set the weighted-sum parameters in a page's uniform data (WGSL ``Page``); return the data."""
    weighted, depth_range = splat_set.weighted, splat_set.depth_range
    assert weighted is not None
    uniform["per_cell"] = splat_set.data.per_cell
    uniform["inverse_range"] = 0 if depth_range is None else 1 / depth_range
    uniform["inverse_divisor"], uniform["behind"] = (
        1 / weighted.opacity_divisor,
        weighted.background,
    )
    return uniform
