"""The part of a frame's recorded GPU work that draws splat sets by weighted sums.

Only cells are sorted and listed per tile, and their Gaussians are looked up through them. A Gaussian
needs neither sort keys nor pairs of its own. Where there are more Gaussians than a GPU binding holds,
cells are drawn in slabs of depth, and sums go on from slab to slab.
"""

__all__ = ["WeightedPart"]

from collections.abc import Iterator, Sequence
from typing import final

import numpy as np
from jaxtyping import Shaped

from gsgen.contract.spec import layout
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.kernels.project.project import PAGE, page_uniform
from gsgen.runtime.kernels.shared import counts as counting
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import VEC4, Step
from gsgen.runtime.kernels.shared.shader import TILE
from gsgen.runtime.kernels.sort.sort import Columns
from gsgen.runtime.kernels.tiles.blend_tiles import Layers
from gsgen.runtime.kernels.tiles.blend_wsr import PLANE_COUNT_BY_NORMAL
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.renderer.plan_options import ImageSpec, RasterMethod
from gsgen.runtime.renderer.slabs import Slabs
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Output
from gsgen.runtime.scene.scene import SplatSet


@final
class WeightedPart:
    """GPU buffers and dispatches of a frame that draw splat sets by weighted-sum rendering.

    Args:
        kernels: Kernels of a device.
        placed: Pages of weighted sets.
        image: The images to draw.
        method: How they are drawn.
        frames: Uniforms of the frame with the background and without it.
        layers: Layers whose first receives the result; None if the result is the image.

    Attributes:
        stages: Steps of a frame, by stage.
        buffers: Buffers of the part, by name.
        images: Image buffers, by output; empty if the result is a layer.
        counts: Counts of cells, of their pairs and of drawn Gaussians.
        inputs: The uniforms that :meth:`write` writes, and the counts, by name.
        clears: Buffers whose bytes are zero at the start of a frame, as in a plan.
        slabs: Buffers and steps of sets that are drawn in slabs of depth, or None.
    """

    def __init__(
        self,
        kernels: Kernels,
        placed: Sequence[tuple[SplatSet, Page]],
        image: ImageSpec,
        method: RasterMethod,
        frames: tuple[Buffer, Buffer],
        layers: Layers | None,
    ) -> None:
        device = self._device = kernels.device
        self._kernels, self._image, self._rasterisation, self._layers = (
            kernels,
            image,
            method,
            layers,
        )
        self._frame_uniform, self._black_frame = frames
        self._tiles = image.tiles(TILE)
        self.buffers: dict[str, Buffer] = {}
        self.images: dict[str, Buffer] = {}
        self._gaussians_per_slot = min(splat_set.data.per_cell for splat_set, _ in placed)
        slab_splats = method.slabs.weighted
        self._gaussians = slab_splats or sum(page.capacity for _, page in placed)
        self._cells = sum(_cells(page) for _, page in _weighted_sets(placed))
        self.slabs: Slabs | None = None
        if slab_splats is not None:
            self._cells = max(1, slab_splats // self._gaussians_per_slot)
            pages = [page for _, page in placed]
            with_ids = "depth" in image.outputs and layers is None
            self.slabs = Slabs(kernels, pages, slab_splats, None, with_ids=with_ids, weighted=True)
            self.buffers |= self.slabs.buffers
        self.counts = self._storage(
            "counts of cells", counting.COUNTERS_BYTES, extra_usage="INDIRECT"
        )
        device.write(self.counts, counting.initial(self._cells, method.pair_capacity))
        self._ranges = self._storage("ranges of cells", 8 * self._tiles[0] * self._tiles[1])
        self._slots = device.uniform("pages with cells", PAGE.itemsize * len(placed))
        self._cell_slots = device.uniform("sets of cells", PAGE.itemsize * len(placed))
        self.inputs = {"pages": self._slots, "sets": self._cell_slots, "counts": self.counts}
        self.buffer_clears: list[tuple[Buffer, int, int | None]] = [
            (self._ranges, 0, None),
            (self.counts, 4 * Counts.DRAWN, 12),  # to UNSORTED
        ]
        if self.slabs is not None:
            self.buffer_clears.append((self.slabs.key_counts, 0, None))
        self.stages = self._record(placed, image.outputs)

    def _storage(self, name: str, size: int, *, extra_usage: str = "") -> Buffer:
        self.buffers[name] = self._device.storage(name, size, extra_usage=extra_usage)
        return self.buffers[name]

    def _allocate_columns(self, name: str, length: int) -> Columns:
        return Columns(
            self._storage(f"keys of {name}", 4 * length),
            self._storage(f"values of {name}", 4 * length),
        )

    def _record(
        self, placed: Sequence[tuple[SplatSet, Page]], outputs: frozenset[Output]
    ) -> dict[str, list[Step]]:
        n = self._gaussians
        # Stage 1: a splat for each Gaussian, and depth, circle and members for each cell.
        shapes, weights, colors = (
            self._storage(f"weighted {name}", VEC4 * n) for name in ("shapes", "weights", "colors")
        )
        columns = (
            self._allocate_columns("cells a", self._cells),
            self._allocate_columns("cells b", self._cells),
        )
        low_keys = self._storage("lows of cells", 4 * self._cells)
        cell_circles = self._storage("circles of cells", VEC4 * self._cells)
        spans = self._storage("spans of cells", VEC4 * self._cells)
        normals = self._storage("weighted normals", VEC4 * n) if "normal" in outputs else None
        splats, cells = (shapes, weights, colors), (columns[0].keys, cell_circles, spans)
        if self.slabs is not None:
            stages = self._project_slab(self.slabs, placed, splats, (*cells, low_keys), normals)
        else:
            stages = self._project_all(placed, splats, (cells, low_keys), normals)
        # Stage 2: sort the cells by depth; within a cell the order of Gaussians does not matter.
        stages["sort cells"], order = self._sort(columns, low_keys)
        # Stage 3: list the tiles of each cell, and sort the pairs by tile.
        pairs = [
            self._allocate_columns(f"pairs of cells {side}", self._rasterisation.pair_capacity)
            for side in "ab"
        ]
        stages["bin cells"] = self._bin_steps(order, cell_circles, pairs[0])
        stages["group cells"], members = self._group_steps(pairs)
        # Stage 4: sum the Gaussians of the cells of each tile, once per output.
        known_buffers = (self._ranges, members, spans, shapes, weights)
        if "color" in outputs or self._layers is not None:
            stages["sum"] = [self._blend("color", (*known_buffers, colors))]
        if "depth" in outputs and self._layers is None:
            ids = colors if self.slabs is None else self.slabs.taker_ids
            stages["sum depth"] = [self._blend("depth", (*known_buffers, ids), pick=True)]
        if normals is not None:
            stages["sum normal"] = [self._blend("normal", (*known_buffers, normals))]
        return stages

    def _project_all(
        self,
        placed: Sequence[tuple[SplatSet, Page]],
        splats: tuple[Buffer, ...],
        cells: tuple[tuple[Buffer, ...], Buffer],
        normals: Buffer | None,
    ) -> dict[str, list[Step]]:
        """Return the GPU stages that project all Gaussians and cells (groups of Gaussians).

        Args:
            placed: The pages.
            splats: Buffers of the Gaussians' splats, in order.
            cells: Buffers of the cells: keys, circles, spans; and remainders of depths.
            normals: Buffer of normals; None if they are not requested.
        """
        keys, (projected, low_keys) = self._storage("keys of weighted", 4 * self._gaussians), cells
        stages = {
            "project weighted": self._project(placed, (keys, *splats)),
            "project cells": self._project_cells(placed, (*projected, keys, self.counts, low_keys)),
        }
        if normals is not None:
            stages["project weighted"] += self._normal_steps(placed, keys, normals)
        return stages

    def _project_slab(
        self,
        slabs: Slabs,
        placed: Sequence[tuple[SplatSet, Page]],
        splats: tuple[Buffer, ...],
        cells: tuple[Buffer, ...],
        normals: Buffer | None,
    ) -> dict[str, list[Step]]:
        """Return the GPU stages that choose and project the Gaussians and cells of a depth slab.

        Arguments are those of :meth:`_project_all`.
        """
        projection = self._image.projection
        kernel = self._kernels.slab_cells(projection=projection)
        keys, steps = list[Step](), list[Step]()
        for slot, (_, page) in enumerate(placed):
            assert page.cells is not None
            bound_buffers = (self._frame_uniform, slabs.keys[slot])
            keys.append(kernel.key_step(*bound_buffers, self._slots, slot, page, page.cells))
            steps += slabs.place_steps(slot, self.counts, self._slots)
            project = self._kernels.project_weighted(page, projection=projection, slab="splats")
            output_buffers = (self._frame_uniform, self.counts, *splats)
            steps.append(
                project.step(
                    output_buffers, self._slots, slot, page, page.cells, slabs.place_buffer
                )
            )
            output_buffers = (self._frame_uniform, *cells, slabs.place_buffer)
            steps.append(kernel.cell_step(output_buffers, self._slots, slot, page, page.cells))
            if normals is not None:
                normals_kernel = self._kernels.normals(page, placed=True)
                steps.append(
                    normals_kernel.step(slabs.place_buffer, normals, self._slots, slot, page)
                )
        return {
            "keys of cells": keys,
            "tally cells": slabs.tally_steps(self._slots),
            "project weighted": steps,
        }

    def _project(
        self, placed: Sequence[tuple[SplatSet, Page]], outputs: tuple[Buffer, ...]
    ) -> list[Step]:
        recorded_stages = []
        for slot, (_, page) in enumerate(placed):
            kernel = self._kernels.project_weighted(page, projection=self._image.projection)
            bound_buffers = (self._frame_uniform, *outputs)
            recorded_stages.append(kernel.step(bound_buffers, self._slots, slot, page, page.cells))
        return recorded_stages

    def _project_cells(
        self, placed: Sequence[tuple[SplatSet, Page]], outputs: tuple[Buffer, ...]
    ) -> list[Step]:
        kernel = self._kernels.project_cells(projection=self._image.projection)
        bound_buffers = (self._frame_uniform, *outputs)
        return [
            kernel.step(bound_buffers, self._cell_slots, slot, page.cells, _cells(page))
            for slot, (_, page) in enumerate(_weighted_sets(placed))
        ]

    def _normal_steps(
        self, placed: Sequence[tuple[SplatSet, Page]], keys: Buffer, normals: Buffer
    ) -> list[Step]:
        return [
            self._kernels.normals(page).step(keys, normals, self._slots, slot, page)
            for slot, (_, page) in enumerate(placed)
        ]

    def _sort(
        self, columns: tuple[Columns, Columns], low_keys: Buffer
    ) -> tuple[list[Step], Buffer]:
        """Return GPU dispatches that sort groups of Gaussians by depth, and the sorted buffer."""
        n = self._cells
        spare_keys = (
            self._storage("keys of cells c", 4 * n) if self._rasterisation.sort == "deep" else None
        )
        return self._kernels.order.steps(n, self.counts, columns, low_keys, None, spare_keys)

    def _bin_steps(self, order: Buffer, cell_circles: Buffer, pairs: Columns) -> list[Step]:
        walk_rows = self._kernels.sort_config.walk_rows
        run_pairs = self._storage("run pairs of cells", 4 * -(-self._cells // walk_rows))
        measure_step, emit_step = self._kernels.bin_cells(panorama=self._image.panorama).steps(
            self.counts, (self._frame_uniform, self.counts, order, cell_circles, run_pairs, *pairs)
        )
        scan_steps = self._kernels.scan.steps(
            self.counts, run_pairs, source=Counts.VISIBLE, block=walk_rows, total=Counts.PAIRS
        )
        return [measure_step, *scan_steps, emit_step]

    def _group_steps(self, pairs: list[Columns]) -> tuple[list[Step], Buffer]:
        """Return GPU dispatches that sort pairs of Gaussian group and tile, and their buffer."""
        bits = self._kernels.tile_bits(self._tiles[0] * self._tiles[1] - 1)
        steps, side = self._kernels.sort.steps(
            self.counts,
            self._kernels.sort.histograms(self._rasterisation.pair_capacity, bits),
            pairs,
            bits=bits,
            source=Counts.PAIRS,
            groups=Counts.SORT_PAIRS_GROUPS,
        )
        range_step = self._kernels.ranges.step(self.counts, pairs[side].keys, self._ranges)
        return [*steps, range_step], pairs[side].values

    def _blend(self, name: str, resources: tuple[Buffer, ...], *, pick: bool = False) -> Step:
        pixels, uses_slabs = self._image.pixels, self.slabs is not None
        if self._layers is not None:
            # What slabs keep is at the end of the layers' depths: of colours, then of normals.
            numbers, last = self._layers.depths.size // (4 * pixels), name == "normal"
            layer_input_count = 1 if last or self._layers.normals is None else 2
            first_plane = (
                numbers - layer_input_count * PLANE_COUNT_BY_NORMAL[False] if uses_slabs else None
            )
            kernel = self._kernels.blend_wsr(
                pick=False,
                panorama=self._image.panorama,
                layers=self._layers.count,
                first_plane=first_plane,
            )
            image = self._layers.normals if last else self._layers.colors
            bound_buffers = (self._black_frame, *resources, image)
            return kernel.step(self._tiles, bound_buffers, self._layers.depths)
        self.images[name] = self._storage(f"{name} image", VEC4 * pixels)
        frame = self._frame_uniform if name == "color" else self._black_frame
        sums = (
            self._storage(f"{name} kept", 4 * PLANE_COUNT_BY_NORMAL[pick] * pixels)
            if uses_slabs
            else None
        )
        kernel = self._kernels.blend_wsr(
            pick=pick,
            panorama=self._image.panorama,
            published=self._rasterisation.backgrounds == "published",
            first_plane=0 if uses_slabs else None,
        )
        return kernel.step(self._tiles, (frame, *resources, self.images[name]), sums)

    def write(self, placed: Sequence[tuple[SplatSet, Page]], camera: Camera) -> None:
        """Write the uniform buffers of a frame for weighted-sum rendering of splat sets."""
        slots, base = np.zeros(len(placed), PAGE), 0
        cell_slots, cell_base, number = np.zeros(len(placed), PAGE), 0, 0
        for slot, (splat_set, page) in enumerate(placed):
            if page.first == 0:
                live_rows = -(-splat_set.data.count // splat_set.data.per_cell)
                uniform = page_uniform(splat_set, camera, cell_base, _cells(page), live_rows)
                cell_slots[number] = _set_weights(uniform, splat_set)
                cell_slots[number]["first_gaussian"] = base
                cell_base, number = cell_base + _cells(page), number + 1
            live_rows = min(max(splat_set.data.count - page.first, 0), page.capacity)
            uniform = page_uniform(splat_set, camera, base, page.capacity, live_rows)
            slots[slot] = _set_weights(uniform, splat_set)
            slots[slot]["first_row"] = page.first
            base += page.capacity
        if self.slabs is not None:
            slots["per_slot"] = self._gaussians_per_slot
            slots["first_cell"] = [page.first_cell for _, page in placed]
            slots["live_cells"] = [-(-s.data.count // s.data.per_cell) for s, _ in placed]
        self._device.write(self._slots, slots)
        self._device.write(self._cell_slots, cell_slots)


def _weighted_sets(placed: Sequence[tuple[SplatSet, Page]]) -> Iterator[tuple[SplatSet, Page]]:
    """Yield each splat set drawn by weighted sums, with the first of its pages (GPU buffers)."""
    return ((splat_set, page) for splat_set, page in placed if page.first == 0)


def _cells(page: Page) -> int:
    """Return the number of cells (groups of Gaussians) of the splat set in a page (GPU buffers)."""
    return 0 if page.cells is None else page.cells.size // (4 * layout.ROW_LENGTH)


def _set_weights(uniform: Shaped[np.ndarray, ""], splat_set: SplatSet) -> Shaped[np.ndarray, ""]:
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
