"""The GPU stages that list the drawn splats of each image tile, nearest first, and blend them."""

__all__ = [
    "EyeSplats",
    "SplatArrays",
    "TileBlending",
    "TileLists",
    "allocate_columns",
    "draw_eyes",
    "draw_tiles",
    "stages_of_eye",
]

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple, final

from gsgen.runtime.gpu.handles import Buffer, Resource
from gsgen.runtime.kernels.project.project import Eyes
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import VEC4, Step
from gsgen.runtime.kernels.shared.shader import EYE_ROWS
from gsgen.runtime.kernels.sort.scan import MAX_COUNT
from gsgen.runtime.kernels.sort.sort import Columns
from gsgen.runtime.kernels.tiles.bin_tiles import BinTiles
from gsgen.runtime.kernels.tiles.blend_tiles import Layers
from gsgen.runtime.kernels.tiles.list_tiles import run_count
from gsgen.runtime.renderer.bands import CountsAndImages, side_by_side
from gsgen.runtime.renderer.kernel_set import RECORD_BYTES, Kernels
from gsgen.runtime.renderer.plan_options import ImageSpec
from gsgen.runtime.scene.frame import OUTPUTS, Output

_RIGHT: Final = "right "  # how the names of a right eye's stages begin

Storage = Callable[[str, int], Buffer]


class EyeSplats(NamedTuple):
    """The parts of the GPU buffers of projected splats that belong to one eye.

    Attributes:
        vectors: The two vectors of each splat.
        colors: Colours; where lists are not counted, the last of four words is the number of tiles.
        tiles_of: What tells the tiles of a splat: see :class:`TileLists`.
    """

    vectors: tuple[Resource, Resource]
    colors: Resource
    tiles_of: Resource


@final
class SplatArrays:
    """The GPU buffers of the projected splats of a camera, or of a left and then a right eye.

    Args:
        kernels: Kernels of the device.
        storage: Allocates a buffer of a name and a number of bytes.
        gaussians: Most splats of an eye.
        eyes: Number of eyes.

    Attributes:
        records: Whether the two vectors of a splat are one record.
        low_keys: Remainders of the depths; where lists are counted, then the windows of each eye.
        written: What projection writes besides keys: vectors, colours and remainders.
    """

    def __init__(self, kernels: Kernels, storage: Storage, gaussians: int, eyes: Eyes) -> None:
        # The right eye's splats begin where each device can bind them.
        self._part = gaussians if eyes == 1 else max(1, -(-gaussians // EYE_ROWS)) * EYE_ROWS
        self._lists, self._has_parts = kernels.lists, eyes > 1
        splats = self._part * eyes
        self.records = kernels.records(splats)
        self._stride = RECORD_BYTES if self.records else VEC4
        shapes = storage("shapes", self._stride * splats)
        weights = storage("weights", 0 if self.records else VEC4 * splats)
        self._vectors = shapes, shapes if self.records else weights
        self._colors = storage("colors", VEC4 * splats)
        self.low_keys = storage("lows", 4 * (1 + self._lists * eyes) * self._part)
        self.written = (shapes, weights, self._colors, self.low_keys)

    def of_eye(self, eye: int) -> EyeSplats:
        """Return the splats of an eye: 0 for the left one or the camera, 1 for the right one."""
        first, second = (self._slice(buffer, eye, self._stride) for buffer in self._vectors)
        colors = self._slice(self._colors, eye, VEC4)
        # The windows of an eye are the second half of what its kernels read of the remainders.
        windows = self._slice(self.low_keys, eye, 4, 2 * self._part)
        return EyeSplats((first, second), colors, windows if self._lists else colors)

    def _slice(self, buffer: Buffer, eye: int, stride: int, rows: int | None = None) -> Resource:
        """Return the part of an eye; a buffer of one eye alone is bound whole."""
        if not self._has_parts:
            return buffer
        return buffer, eye * self._part * stride, (rows or self._part) * stride


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TileLists:
    """The GPU buffers used to list splats by image tile, with the capacities of the lists.

    Attributes:
        storage: Allocates a buffer of a name and a number of bytes.
        frame: The frame's uniform.
        counts: The frame's counts.
        order: Splats, nearest first.
        splats: The splats of an eye. What tells their tiles are, where lists are counted, the
            words of ``tile_window.wgsl`` in the second half of a buffer; else the last of the four
            words of a colour is their number.
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
    splats: EyeSplats
    ranges: Buffer
    scratch_buffer: Buffer
    gaussians: int
    pair_capacity: int
    tiles: int


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TileBlending:
    """What the listed splats of image tiles are blended to.

    Attributes:
        image: The images.
        outputs: The outputs that are blended by tiles.
        bare_frame: The frame's uniform with nothing behind, for depths and normals.
        normals: By splat, or None without this output.
        layers: Images that are blended among the splats, or None.
        has_slabs: Whether splats are drawn in slabs of depth.
        taker_ids: Ids of the splats of slabs, or None for those of the buffers.
    """

    image: ImageSpec
    outputs: frozenset[Output]
    bare_frame: Buffer
    normals: Buffer | None = None
    layers: Layers | None = None
    has_slabs: bool = False
    taker_ids: Buffer | None = None


class DrawnTiles(NamedTuple):
    """The stages that draw splats by tiles.

    Attributes:
        stages: Steps, by stage.
        images: Buffers of images, by output.
        cleared: Buffers that are zero at the start of a frame.
    """

    stages: dict[str, list[Step]]
    images: dict[str, Buffer]
    cleared: list[Buffer]


def draw_tiles(
    kernels: Kernels, lists: TileLists, blending: TileBlending, *, records: bool
) -> DrawnTiles:
    """Return the stages that list sorted splats by tile, and blend each tile once per output."""
    image, layers, splats = blending.image, blending.layers, lists.splats
    # Stages 3 and 4: list the splats of each tile, in order of depth.
    stages, members, cleared = _list_splats(
        kernels, lists, panorama=image.panorama, records=records
    )
    # Stage 5: blend each tile, once per output; normals are blended like colours.
    images = dict[str, Buffer]()
    blended = {"depth": blending.taker_ids, "normal": blending.normals}
    for output in OUTPUTS:
        if output not in blending.outputs:
            continue
        kernel = kernels.blend(
            output,
            panorama=image.panorama,
            layers=layers.count if layers else 0,
            records=records,
            has_small_dilation=image.dilation == "small",
            carried_layers=blending.has_slabs,
        )
        images[output] = lists.storage(f"{output} image", VEC4 * image.pixels)
        frame = lists.frame if output == "color" else blending.bare_frame
        colors = blended.get(output) or splats.colors
        resources = (frame, lists.ranges, members, *splats.vectors, colors, images[output])
        layer_buffers = None
        if layers is not None:
            layer_colors = layers.normals if output == "normal" else layers.colors
            layer_buffers = layer_colors, layers.depths
        tiles = image.tiles(kernels.sort_config.tile)
        stages["blend" if output == "color" else output] = [
            kernel.step(tiles, resources, layer_buffers)
        ]
    return DrawnTiles(stages, images, cleared)


def stages_of_eye(eye: int, stages: dict[str, list[Step]]) -> dict[str, list[Step]]:
    """Return the stages of an eye by their names in a plan: 0 for the left eye, or a camera."""
    return {f"{_RIGHT if eye else ''}{name}": steps for name, steps in stages.items()}


def draw_eyes(
    stages: Iterable[str], draw: Callable[[int, list[str]], CountsAndImages]
) -> CountsAndImages:
    """Draw the images of a left and a right eye in turn, from splats that are sorted once.

    Args:
        stages: Names of all stages of a plan of two eyes.
        draw: Runs stages for an eye, 0 or 1.

    Returns:
        Those of :func:`side_by_side`.
    """
    right_stages = [name for name in stages if name == "meshes" or name.startswith(_RIGHT)]
    left_stages = [name for name in stages if not name.startswith(_RIGHT)]
    return side_by_side(draw(0, left_stages), draw(1, right_stages))


def _list_splats(
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
    """Return the results of ``_list_splats`` for kernels that count splats instead of sorting."""
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
            lists.splats.tiles_of,
            counters,
            members,
            *lists.splats.vectors,
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
    resources = (lists.frame, lists.counts, lists.order, lists.splats.tiles_of, run_pairs)
    measure_step, emit_step = kernel.steps(
        lists.counts, (*resources, *pairs, *lists.splats.vectors), histogram
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
