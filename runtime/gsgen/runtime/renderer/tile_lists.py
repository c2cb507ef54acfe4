"""The GPU stages that list the drawn splats of each image tile, nearest first."""

__all__ = ["TileLists", "allocate_columns", "list_splats"]

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import Step
from gsgen.runtime.kernels.sort.scan import MAX_COUNT
from gsgen.runtime.kernels.sort.sort import Columns
from gsgen.runtime.kernels.tiles.bin_tiles import BinTiles
from gsgen.runtime.kernels.tiles.list_tiles import run_count
from gsgen.runtime.renderer.kernel_set import Kernels

Storage = Callable[[str, int], Buffer]


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TileLists:
    """The GPU buffers used to list splats by image tile, with the capacities of the lists.

    Attributes:
        storage: Allocates a buffer of a name and a number of bytes.
        frame: The frame's uniform.
        counts: The frame's counts.
        order: Splats, nearest first.
        tiles_of: By splat, the tiles that it touches: where lists are counted, the words of
            ``tile_window.wgsl`` in the second half; else the last of four words is their number.
        splats: The two vectors of each splat.
        ranges: The buffer of the first and the last list entry of each tile.
        scratch_buffer: A word per splat that no later stage reads.
        gaussians: Most splats.
        pair_capacity: Most pairs of a splat and a tile.
        tiles: Number of tiles of the image.
    """

    storage: Storage
    frame: Buffer
    counts: Buffer
    order: Buffer
    tiles_of: Buffer
    splats: list[Buffer]
    ranges: Buffer
    scratch_buffer: Buffer
    gaussians: int
    pair_capacity: int
    tiles: int


def list_splats(
    kernels: Kernels, lists: TileLists, *, panorama: bool, records: bool
) -> tuple[dict[str, list[Step]], Buffer, list[Buffer]]:
    """Return stages that list splats by image tile, the buffer of lists, and buffers to clear."""
    if kernels.lists:
        return _draw_counting_lists(kernels, lists, panorama=panorama)
    # A pair has the tile as its key. Pairs are listed in order of depth and sorted by tile, stably:
    # each tile then has its splats together, nearest first.
    pairs = [allocate_columns(lists.storage, f"pairs {side}", lists.pair_capacity) for side in "ab"]
    bits = kernels.tile_bits(lists.tiles - 1)
    histograms = kernels.sort.histograms(lists.pair_capacity, bits)
    kernel = kernels.bin_tiles(
        panorama=panorama, records=records, digits=kernels.sort.first_digits(bits)
    )
    stages = dict[str, list[Step]]()
    stages["bin"] = _bin_steps(kernels, lists, kernel, pairs[0], histograms[0])
    stages["group"], members = _group_steps(kernels, lists, pairs, bits, histograms)
    return stages, members, [histograms[0]]


def _draw_counting_lists(
    kernels: Kernels, lists: TileLists, *, panorama: bool
) -> tuple[dict[str, list[Step]], Buffer, list[Buffer]]:
    """Return the results of ``list_splats`` for kernels that count splats instead of sorting."""
    # Each run of sorted splats counts its splats by tile. Sums of those counters tell where each run
    # lists its splats of a tile, so that a list is in order of depth without a sort.
    counters = lists.storage("counters of tiles", 4 * run_count(lists.tiles) * lists.tiles)
    totals = lists.storage("totals of tiles", 4 * lists.tiles)
    members = lists.storage("splats of tiles", 4 * lists.pair_capacity)
    uniforms = (lists.frame, lists.counts)
    tally_step, total_step, begin_step, fill_step = kernels.list_tiles(panorama=panorama).steps(
        lists.tiles,
        (
            *uniforms,
            lists.order,
            lists.tiles_of,
            counters,
            members,
            *lists.splats,
            lists.scratch_buffer,
        ),
        (*uniforms, counters, totals, lists.ranges),
    )
    scan_steps = kernels.scan.steps(
        lists.counts,
        totals,
        source=Counts.VISIBLE,
        block=MAX_COUNT,
        rows=lists.tiles,
        total=Counts.PAIRS,
    )
    return (
        {"bin": [tally_step, total_step, *scan_steps, begin_step], "group": [fill_step]},
        members,
        [counters],
    )


def _bin_steps(
    kernels: Kernels, lists: TileLists, kernel: BinTiles, pairs: Columns, histogram: Buffer
) -> list[Step]:
    """Return dispatches that list splat-tile pairs, nearest first, and count their first digits."""
    walk_rows = kernels.sort_config.walk_rows
    run_pairs = lists.storage("run pairs", 4 * -(-lists.gaussians // walk_rows))
    resources = (lists.frame, lists.counts, lists.order, lists.tiles_of, run_pairs)
    measure_step, emit_step = kernel.steps(
        lists.counts, (*resources, *pairs, *lists.splats), histogram
    )
    scan_steps = kernels.scan.steps(
        lists.counts, run_pairs, source=Counts.VISIBLE, block=walk_rows, total=Counts.PAIRS
    )
    return [measure_step, *scan_steps, emit_step]


def _group_steps(
    kernels: Kernels,
    lists: TileLists,
    pairs: list[Columns],
    bits: int,
    histograms: tuple[Buffer, ...],
) -> tuple[list[Step], Buffer]:
    """Return the dispatches that sort splat-tile pairs by tile, and the buffer of pairs."""
    steps, side = kernels.sort.steps(
        lists.counts,
        histograms,
        pairs,
        bits=bits,
        source=Counts.PAIRS,
        groups=Counts.SORT_PAIRS_GROUPS,
        has_histogram=kernels.sort_config.is_staged,
    )
    range_step = kernels.ranges.step(lists.counts, pairs[side].keys, lists.ranges)
    return [*steps, range_step], pairs[side].values


def allocate_columns(storage: Storage, name: str, length: int) -> Columns:
    """Allocate GPU buffers for ``length`` sort keys and their values, named after the elements."""
    return Columns(storage(f"keys of {name}", 4 * length), storage(f"values of {name}", 4 * length))
