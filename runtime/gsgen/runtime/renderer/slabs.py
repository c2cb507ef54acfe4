"""Divides a scene of too many splats for a GPU binding into depth slabs, drawn nearest first."""

__all__ = [
    "WITHOUT_SLABS",
    "KeyRange",
    "SlabSizes",
    "SlabState",
    "Slabs",
    "draw_parts",
    "extra_layers",
    "max_slab_splats",
    "max_sorted_rows",
    "slab_ranges",
]

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple, Protocol, final

import numpy as np
from jaxtyping import Shaped

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import Page, is_larger_than_binding
from gsgen.runtime.kernels.project.place_splats import PAGE_BYTES, PLACEMENT_BLOCK_ROWS
from gsgen.runtime.kernels.project.projections import Projection
from gsgen.runtime.kernels.project.tally_keys import BIN_COUNT
from gsgen.runtime.kernels.shared import counts as counting
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import VEC4, Step
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.kernels.tiles.blend_wsr import PLANE_COUNT_BY_NORMAL
from gsgen.runtime.renderer.bands import CountsAndImages
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.renderer.placed_pages import PlacedPage, sorted_pages, weighted_pages
from gsgen.runtime.scene.frame import OUTPUTS
from gsgen.runtime.scene.scene import Scene

_SLAB_STAGES: Final = ("project", "sort", "bin", "group", "blend", "depth", "normal")
_CELL_KERNEL_STAGES: Final = (
    *("project weighted", "sort cells", "bin cells", "group cells"),
    *("sum", "sum depth", "sum normal"),
)

_REDRAW_COUNTERS: Final = [Counts.TIED, Counts.UNSORTED]
_ROW_TIED_COUNT: Final = 2  # numbers of ``KeyRange.tied`` if keys are rows, or cells
_CELL_TIED_COUNT: Final = 3  # the same if keys are rows of one cell
_COUNTERS_SUMMED_OVER_SLABS: Final = [Counts.VISIBLE, Counts.PAIRS, Counts.DRAWN]
_BIN_BITS: Final = BIN_COUNT.bit_length() - 1
_KEY_BITS: Final = 31  # keys are bits of positive floats

CountKeys = Callable[[tuple[int, ...], int, int], np.ndarray]
"""Counts the sort keys of a frame in BINS bins, from a first key on, of 2^shift keys each. The first
argument is that of a :class:`KeyRange`."""


@final
@dataclass(frozen=True, slots=True)
class KeyRange:
    """The splats of a depth slab: those whose sort keys are in a range.

    Attributes:
        low: First key.
        high: One past the last key.
        tied_keys: Empty if keys are depths. If splats of one depth are divided, its key; then keys are
            remainders. If splats of one remainder are divided, it follows; then keys are rows. For
            weighted sums these are the first rows of cells. If one cell is divided, its first row
            follows; then keys are rows.
        splats: Number of splats.
    """

    low: int
    high: int
    tied_keys: tuple[int, ...] = ()
    splats: int = 0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SlabState:
    """How a depth slab is drawn: whether nearer slabs precede it and farther slabs follow it.

    Attributes:
        resumes: Whether the image holds the state of pixels after nearer slabs.
        continues: Whether the image keeps the state of pixels for farther slabs.
        tied_keys: See :class:`KeyRange`.
        splats: See :class:`KeyRange`.
        resumes_cell: Whether the last nearer slab ended within the cell of this one.
        weighted: Whether the slab is one of weighted sums.
    """

    resumes: bool = False
    continues: bool = False
    tied_keys: tuple[int, ...] = ()
    splats: int = 0
    resumes_cell: bool = False
    weighted: bool = False

    def write_uniform(self, uniform: Shaped[np.ndarray, ""]) -> Shaped[np.ndarray, ""]:
        """Write these slab settings to a frame's uniform data (WGSL ``Frame``); return the data."""
        uniform["resumes"] = self.resumes + self.resumes_cell
        uniform["continues"] = self.continues
        uniform["rank"] = len(self.tied_keys)
        tied_values = (
            (self.tied_keys[-1], self.splats)
            if len(self.tied_keys) == _CELL_TIED_COUNT
            else (*self.tied_keys, 0, 0)
        )
        uniform["tied_key"], uniform["tied_low"] = tied_values[:_ROW_TIED_COUNT]
        return uniform


class DrawSlab(Protocol):
    """Function that draws a depth slab; returns GPU counters, and images after the last slab."""

    def __call__(self, only: Sequence[str], state: SlabState) -> CountsAndImages:
        """Run the GPU stages named in ``only`` for one depth slab, as ``Plan.submit`` does."""
        ...


def max_slab_splats(device: Device, kernels: Kernels) -> int:
    """Return how many splats a GPU can sort, list and bind at once."""
    return min(device.largest_binding // VEC4, kernels.max_binned_splats)


class SlabSizes(NamedTuple):
    """The most splats of a slab of each kind, or None where all are drawn at once.

    Attributes:
        splats: Of depth-sorted splats.
        weighted: Of weighted sums.
    """

    splats: int | None = None
    weighted: int | None = None

    @classmethod
    def of(cls, placed: Sequence[PlacedPage], max_splats: int) -> "SlabSizes":
        """Return the sizes for the pages (GPU buffers) of a scene, and ``max_splats`` splats at once."""
        weighted_data = weighted_pages(placed)
        is_paged = any(page.first_cell for _, page in weighted_data)
        return cls(
            max_splats if _rows(sorted_pages(placed)) > max_splats else None,
            max_splats if _rows(weighted_data) > max_splats or is_paged else None,
        )

    def numbers_per_pixel(self, layers: int, *, normal: bool) -> int:
        """Return how many numbers per pixel slabs keep with the depths of image layers.

        Args:
            layers: Number of layers.
            normal: Whether normals are requested.
        """
        numbers = layers * len(OUTPUTS) if self.splats is not None else 0
        return numbers + (
            PLANE_COUNT_BY_NORMAL[False] * (1 + normal) if self.weighted is not None else 0
        )


WITHOUT_SLABS: Final = SlabSizes()
"""The sizes for a scene that no slabs divide."""


def extra_layers(scene: Scene, device: Device, max_splats: int) -> int:
    """Return how many image layers more, of 16 bytes per pixel, hold what slabs of cells keep.

    Args:
        scene: The scene.
        device: The device.
        max_splats: Most splats of a slab.
    """
    weighted_data = [splat_set.data for splat_set in scene.sets if splat_set.weighted is not None]
    is_paged = any(is_larger_than_binding(device, data) for data in weighted_data)
    if sum(map(len, weighted_data)) <= max_splats and not is_paged:
        return 0
    is_weighted = len(weighted_data) == len(scene.sets) and not scene.pools and not scene.meshes
    return 1 if is_weighted else 2


def max_sorted_rows(placed: Sequence[PlacedPage]) -> int:
    """Return an upper bound of the splats of a scene that are sorted or summed at once."""
    return max(_rows(sorted_pages(placed)), _rows(weighted_pages(placed)))


def _rows(placed: Sequence[PlacedPage]) -> int:
    return sum(page.capacity for _, page in placed)


def slab_ranges(key_counts: CountKeys, capacity: int) -> list[KeyRange]:
    """Divide all splats into ranges of sort keys, of at most ``capacity`` splats each.

    Splats of one depth are divided by its remainder, and those of one remainder by their rows or
    cells; those of one cell by their rows.

    Args:
        key_counts: Counts the keys of the frame.
        capacity: Most splats of a slab.

    Returns:
        At least one range, nearest first.
    """
    return list(_ranges(key_counts, capacity, ()))


def _ranges(key_counts: CountKeys, capacity: int, tied_keys: tuple[int, ...]) -> Iterator[KeyRange]:
    """Yield ranges of depth keys, or of finer keys of splats whose first keys are ``tied_keys``."""
    bits = 32 if tied_keys else _KEY_BITS
    low, splats = 0, 0
    for start, count in _key_bins(partial(key_counts, tied_keys), 0, bits - _BIN_BITS, capacity):
        # Case 1: the range is full.
        if splats and splats + count > capacity:
            yield KeyRange(low, start, tied_keys, splats)
            low, splats = start, 0
        splats += count
        # Case 2: too many splats have this key.
        if count > capacity:
            yield from _ranges(key_counts, capacity, (*tied_keys, start))
            low, splats = start + 1, 0
    if splats or not tied_keys:
        yield KeyRange(low, min(1 << bits, NO_ID), tied_keys, splats)


def _key_bins(
    key_counts: Callable[[int, int], np.ndarray],
    low: int,
    shift: int,
    capacity: int,
    *,
    bins: int = BIN_COUNT,
) -> Iterator[tuple[int, int]]:
    """Yield the first key and splat count of histogram bins, splitting bins above ``capacity``.

    A bin of one key is not split.
    """
    splat_counts = key_counts(low, shift)[:bins]
    for number in np.flatnonzero(splat_counts).tolist():
        start, splat_count = low + (number << shift), int(splat_counts[number])
        if splat_count <= capacity or shift == 0:
            yield start, splat_count
        else:
            finer_shift = max(shift - _BIN_BITS, 0)
            yield from _key_bins(
                key_counts, start, finer_shift, capacity, bins=1 << (shift - finer_shift)
            )


def _add_previous_slabs(previous: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Add up the GPU counters of all depth slabs."""
    total = counts.copy()
    total[_COUNTERS_SUMMED_OVER_SLABS] += previous[_COUNTERS_SUMMED_OVER_SLABS]
    total[Counts.WANTED_PAIRS] = max(counts[Counts.WANTED_PAIRS], previous[Counts.WANTED_PAIRS])
    return total


def _is_redrawn(total: np.ndarray) -> bool:
    """Return whether a frame is drawn again: by other keys, or with more room for pairs."""
    has_too_few_pairs = total[Counts.WANTED_PAIRS] > total[Counts.PAIR_CAPACITY]
    return bool(total[_REDRAW_COUNTERS].any() or has_too_few_pairs)


@final
class Slabs:
    """The GPU buffers and dispatches that draw a scene in slabs of depth.

    The keys of all Gaussians are computed once a frame. Each slab then projects its own Gaussians
    into arrays of ``capacity`` splats, in the order of their rows, so that a slab is sorted and
    blended like a whole scene. Pixels keep their state in the image between slabs.

    Of weighted sums a slab has whole cells: the key of a Gaussian is that of its cell. One cell of
    more Gaussians than a slab is divided by rows, and pixels keep the light before it, too.

    Args:
        kernels: Kernels of a device.
        pages: The pages of the scene.
        capacity: Most splats of a slab.
        origins: Index of each GPU row in the order of the sets; None if rows are in it.
        with_ids: Whether Gaussians are identified, for depths.
        weighted: Whether the pages are those of weighted sums, whose keys and splats the caller
            computes by ``keys`` and ``place_buffer``.

    Attributes:
        buffers: The buffers, by name.
        capacity: Most splats of a slab.
        origins: Index of each splat of the slab in the order of the sets.
        takers: The same as two floats.
        key_counts: The counts of keys.
        keys: The sort keys of each page's rows.
        places: The index in the slab of each row of a page.
    """

    def __init__(
        self,
        kernels: Kernels,
        pages: Sequence[Page],
        capacity: int,
        origins: np.ndarray | None,
        *,
        with_ids: bool,
        weighted: bool = False,
    ) -> None:
        device = kernels.device
        self._device, self._kernels, self._pages = device, kernels, pages
        self._is_weighted_set = weighted
        self._kernel_stages = _CELL_KERNEL_STAGES if weighted else _SLAB_STAGES
        self._key_stages = ["keys of cells", "tally cells"] if weighted else ["keys", "tally"]
        self.capacity = capacity
        self.buffers: dict[str, Buffer] = {}
        rows = max(page.capacity for page in pages)
        self._range_uniform = device.uniform("slab", 16)
        self.keys = [
            self._storage(f"keys of page {slot}", 4 * page.capacity)
            for slot, page in enumerate(pages)
        ]
        self.place_buffer = self._storage("places of a page", 4 * rows)
        self._block_counts = self._storage("block counts", 4 * -(-rows // PLACEMENT_BLOCK_ROWS))
        self._page_ends = self._storage("ends of pages", PAGE_BYTES * (len(pages) + 1))
        self.key_counts = self._storage("tally of keys", 4 * BIN_COUNT)
        self.origins = self._storage("origins", 4 * capacity)
        self.taker_ids = self._storage("takers", VEC4 * capacity if with_ids else 0)
        self._row_origins = list[Buffer]()
        if origins is not None:
            self._row_origins = [self._origins_buffer(slot, origins) for slot in range(len(pages))]

    def _storage(self, name: str, size: int) -> Buffer:
        name = f"{name} of cells" if self._is_weighted_set else name
        self.buffers[name] = self._device.storage(name, size)
        return self.buffers[name]

    def _origins_buffer(self, slot: int, origins: np.ndarray) -> Buffer:
        first = sum(page.capacity for page in self._pages[:slot])
        count = self._pages[slot].capacity
        buffer = self._storage(f"origins of page {slot}", 4 * count)
        self._device.write(buffer, origins[first : first + count])
        return buffer

    def _set_key_range(self, low: int, high: int, shift: int = 0) -> None:
        """Set the range of depth sort keys that the next dispatches count or draw."""
        self._device.write(self._range_uniform, np.array([low, high, shift, 0], np.uint32))

    def draw(self, stages: Sequence[str], run: DrawSlab) -> CountsAndImages:
        """Draw all depth slabs, and return the summed GPU counters and the images.

        Args:
            stages: Names of the frame's stages. Those of others, as of meshes, run once.
            run: Runs stages of the plan.
        """
        key_stage, tally_stage = self._key_stages
        others = (name for name in stages if name not in (*self._kernel_stages, *self._key_stages))
        before = [*self._key_stages, *others]
        stages = [name for name in stages if name in self._kernel_stages]
        ranked_keys: tuple[int, ...] = ()  # by what the keys are
        total = np.zeros(0, np.uint32)

        def key_counts(tied_keys: tuple[int, ...], low: int, shift: int) -> np.ndarray:
            nonlocal ranked_keys
            if tied_keys != ranked_keys:
                before.append(key_stage)
            self._set_key_range(low, min(low + (BIN_COUNT << shift), NO_ID), shift)
            run(
                before,
                SlabState(continues=True, tied_keys=tied_keys, weighted=self._is_weighted_set),
            )
            before[:], ranked_keys = [tally_stage], tied_keys  # the keys stay the same
            return self._device.read(self.key_counts, np.uint32, BIN_COUNT)

        # Step 1: count the keys of all splats, and choose ranges of at most ``capacity``.
        ranges = slab_ranges(key_counts, self.capacity)
        # Step 2: rows that were rearranged in memory cannot be divided by rows.
        if self._row_origins and any(len(keys.tied_keys) == _ROW_TIED_COUNT for keys in ranges):
            total = np.zeros(counting.COUNTERS_BYTES // 4, np.uint32)
            total[Counts.TIED] = 1  # rows return to their own order, and the frame is drawn again
            return total, {}
        # Step 3: draw the slabs, nearest first: pixels go on from the state that the last one left.
        for number, keys in enumerate(ranges):
            self._set_key_range(keys.low, keys.high)
            state = self._state(ranges, number)
            counts, images = run(
                [*([key_stage] if keys.tied_keys != ranked_keys else []), *stages], state
            )
            ranked_keys = keys.tied_keys
            if state.resumes_cell:
                counts[Counts.PAIRS] = 0  # those of the cell were counted
            total = counts if number == 0 else _add_previous_slabs(total, counts)
            if _is_redrawn(total):
                break
        return total, images

    def _state(self, ranges: Sequence[KeyRange], number: int) -> SlabState:
        """Return how the depth slab ``number`` is drawn."""
        slab_range = ranges[number]
        is_in_cell = len(slab_range.tied_keys) == _CELL_TIED_COUNT
        previous_keys = ranges[number - 1].tied_keys if number > 0 else None
        return SlabState(
            resumes=number > 0,
            continues=number + 1 < len(ranges),
            tied_keys=slab_range.tied_keys,
            splats=slab_range.splats,
            resumes_cell=is_in_cell and previous_keys == slab_range.tied_keys,
            weighted=self._is_weighted_set,
        )

    def key_steps(
        self, outputs: tuple[Buffer, ...], uniform: Buffer, *, projection: Projection
    ) -> list[Step]:
        """Return the dispatches that compute the depth sort keys of all Gaussians.

        Args:
            outputs: The outputs of the projection, in order.
            uniform: Buffer with the uniforms of all pages.
            projection: Where Gaussians are projected to.
        """
        steps, (frame, _, *other_buffers) = [], outputs
        for slot, (page, keys) in enumerate(zip(self._pages, self.keys, strict=True)):
            if page.slots is not None:
                cull_kernel = self._kernels.cull_slots(page, projection=projection, keys_only=True)
                steps.append(cull_kernel.step(frame, keys, other_buffers[-1], uniform, slot, page))
            project = self._kernels.project(page, projection=projection, slab="keys")
            steps.append(project.step((frame, keys, *other_buffers), uniform, slot, page))
        return steps

    def tally_steps(self, uniform: Buffer) -> list[Step]:
        """Return the dispatches that count the depth sort keys in the chosen range."""
        kernel = self._kernels.tally()
        return [
            kernel.step(self._range_uniform, keys, self.key_counts, uniform, slot, page)
            for slot, (page, keys) in enumerate(zip(self._pages, self.keys, strict=True))
        ]

    def place_steps(self, slot: int, counts: Buffer, uniform: Buffer) -> list[Step]:
        """Return the dispatches that index the Gaussians of one page in the chosen range of depths.

        Args:
            slot: Index of the page.
            counts: The frame's counts.
            uniform: Buffer with the uniforms of all pages.
        """
        kernel = self._kernels.place(is_reordered=bool(self._row_origins))
        keys = self.keys[slot]
        row_origins = self._row_origins[slot] if self._row_origins else keys
        resources = (self._range_uniform, keys, self._block_counts, self.place_buffer, row_origins)
        output_buffers = (self.origins, self.taker_ids, counts)
        page = self._pages[slot]
        return kernel.steps((*resources, *output_buffers), self._page_ends, uniform, slot, page)

    def project_steps(
        self,
        outputs: tuple[Buffer, ...],
        counts: Buffer,
        uniform: Buffer,
        normals: Buffer | None,
        *,
        projection: Projection,
        records: bool,
    ) -> list[Step]:
        """Return the dispatches that project the Gaussians in the chosen range of depths.

        Args:
            outputs: The outputs of the projection, in order.
            counts: The frame's counts.
            uniform: Buffer with the uniforms of all pages.
            normals: Buffer of normals; None if they are not requested.
            projection: Where Gaussians are projected to.
            records: Whether each splat is one record.
        """
        steps, kernels = list[Step](), self._kernels
        for slot, page in enumerate(self._pages):
            steps += self.place_steps(slot, counts, uniform)
            project = kernels.project(page, projection=projection, records=records, slab="splats")
            steps.append(project.step(outputs, uniform, slot, page, self.place_buffer))
            if normals is not None:
                kernel = kernels.normals(page, placed=True)
                steps.append(kernel.step(self.place_buffer, normals, uniform, slot, page))
        return steps


def draw_parts(
    stages: Sequence[str], run: DrawSlab, weighted: Slabs | None, splats: Slabs | None
) -> CountsAndImages:
    """Draw a frame: first weighted sums in slabs, if they need any, then all else, in slabs or not.

    Args:
        stages: Names of the frame's stages.
        run: Runs stages of the plan.
        weighted: The slabs of weighted sums, or None.
        splats: The slabs of depth-sorted splats, or None.

    Returns:
        The summed GPU counters and the images.
    """
    previous, rest = None, list(stages)
    if weighted is not None:
        slab_range = [name for name in stages if name in ("meshes", *_CELL_KERNEL_STAGES)]
        previous, images = weighted.draw(slab_range, run)
        rest = [name for name in stages if name not in slab_range and "cells" not in name]
        if not rest or _is_redrawn(previous):
            return previous, images
    counts, images = splats.draw(rest, run) if splats is not None else run(rest, SlabState())
    return counts if previous is None else _add_previous_slabs(previous, counts), images
