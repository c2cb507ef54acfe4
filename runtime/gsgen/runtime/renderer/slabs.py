"""Divides a scene of too many splats for a GPU binding into depth slabs, drawn nearest first."""

__all__ = ["KEY_STAGES", "Slabs", "most_splats", "require_pools_fit", "slab_ranges"]

from collections.abc import Callable, Iterator, Sequence
from typing import Final, Protocol, final

import numpy as np

from gsgen.runtime.errors import CapacityExceeded
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import Page
from gsgen.runtime.kernels.project.place_splats import PAGE_BYTES, PLACE_BLOCK
from gsgen.runtime.kernels.project.tally_keys import BINS
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import VEC4, Step
from gsgen.runtime.renderer.bands import Drawing
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.scene.scene import Scene

KEY_STAGES: Final = ("keys", "tally")
"""Stages that compute the keys of a frame and count them, before its slabs are drawn."""

_REDRAWN: Final = [Counts.TIED, Counts.UNSORTED]
_SUMMED: Final = [Counts.VISIBLE, Counts.PAIRS, Counts.DRAWN]
_BIN_BITS: Final = BINS.bit_length() - 1
_KEY_END: Final = 1 << 31  # keys are bits of positive floats
_FIRST_SHIFT: Final = 31 - _BIN_BITS

Tally = Callable[[int, int], np.ndarray]
"""Counts the sort keys of a frame in BINS bins, from a first key on, of 2^shift keys each."""


class Run(Protocol):
    """Function that runs GPU stages of a frame, and returns counters and, at the end, images."""

    def __call__(self, only: Sequence[str], *, resumes: bool, continues: bool) -> Drawing:
        """Run some GPU stages of a frame; see ``Plan.submit`` for the arguments."""
        ...


def most_splats(device: Device, kernels: Kernels) -> int:
    """Return how many splats a GPU can sort, list and bind at once."""
    return min(device.largest_binding // VEC4, kernels.most_binned)


def require_pools_fit(scene: Scene, device: Device, kernels: Kernels) -> None:
    """Raise if a scene with splat pools (streamed tiles) has more splats than a GPU draws at once.

    Slabs draw pages of sets alone, since slots of pools are culled before keys are computed.

    Raises:
        CapacityExceeded: It has more.
    """
    pooled = sum(len(pooled.pool) for pooled in scene.pools)
    splats = pooled + sum(len(splat_set.data) for splat_set in scene.sets)
    most = most_splats(device, kernels)
    if pooled and splats > most:
        raise CapacityExceeded(
            f"room for {pooled:,} streamed Gaussians makes {splats:,} in all; {device.name} draws "
            f"at most {most:,} of a scene that streams",
            where="scene",
            hint="Give tilesets a smaller `--budget` (`max_splats`).",
        )


def slab_ranges(tally: Tally, capacity: int) -> list[tuple[int, int]]:
    """Divide all depth sort keys into ranges of at most ``capacity`` splats each.

    Args:
        tally: Counts the keys of the frame.
        capacity: Most splats of a slab.

    Returns:
        The first key of each range and one past its last, nearest first; at least one range.

    Raises:
        CapacityExceeded: More splats have one key.
    """
    ranges, low, splats = [], 0, 0
    for start, amount in _bins(tally, 0, _FIRST_SHIFT, capacity):
        if splats + amount > capacity:
            ranges.append((low, start))
            low, splats = start, 0
        splats += amount
    return [*ranges, (low, _KEY_END)]


def _bins(
    tally: Tally, low: int, shift: int, capacity: int, *, bins: int = BINS
) -> Iterator[tuple[int, int]]:
    """Yield first depth key and splat count of histogram bins; too full bins are divided."""
    amounts = tally(low, shift)[:bins]
    for number in np.flatnonzero(amounts).tolist():
        start, amount = low + (number << shift), int(amounts[number])
        if amount <= capacity:
            yield start, amount
        elif shift > 0:
            narrower = max(shift - _BIN_BITS, 0)
            yield from _bins(tally, start, narrower, capacity, bins=1 << (shift - narrower))
        else:
            depth = np.uint32(start).view(np.float32)
            raise CapacityExceeded(
                f"{amount:,} splats are at depth {depth}; the device draws at most {capacity:,} "
                "splats of one depth",
                where="scene",
                hint="Turn the camera a little, or draw fewer Gaussians.",
            )


def _total(earlier: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Add up the GPU counters of all depth slabs."""
    total = counts.copy()
    total[_SUMMED] += earlier[_SUMMED]
    total[Counts.WANTED_PAIRS] = max(counts[Counts.WANTED_PAIRS], earlier[Counts.WANTED_PAIRS])
    return total


@final
class Slabs:
    """The GPU buffers and dispatches that draw a scene in slabs of depth.

    The keys of all Gaussians are computed once a frame. Each slab then projects its own Gaussians
    into arrays of ``capacity`` splats, in the order of their rows, so that a slab is sorted and
    blended like a whole scene. Pixels keep their state in the image between slabs.

    Args:
        device: Device of the buffers.
        kernels: Kernels of the device.
        pages: The pages of the scene.
        capacity: Most splats of a slab.
        origins: Index of each GPU row in the order of the sets; None if rows are in it.
        with_ids: Whether Gaussians are identified, for depths.

    Attributes:
        buffers: The buffers, by name.
        capacity: Most splats of a slab.
        origins: Index of each splat of the slab in the order of the sets.
        takers: The same as two floats.
        tally: The counts of keys.
    """

    def __init__(
        self,
        device: Device,
        kernels: Kernels,
        pages: Sequence[Page],
        capacity: int,
        origins: np.ndarray | None,
        *,
        with_ids: bool,
    ) -> None:
        self._device, self._kernels, self._pages = device, kernels, pages
        self.capacity = capacity
        self.buffers: dict[str, Buffer] = {}
        rows = max(page.capacity for page in pages)
        self._range = device.uniform("slab", 16)
        self._keys = [
            self._storage(f"keys of page {slot}", 4 * page.capacity)
            for slot, page in enumerate(pages)
        ]
        self._places = self._storage("places of a page", 4 * rows)
        self._block_counts = self._storage("block counts", 4 * -(-rows // PLACE_BLOCK))
        self._ends = self._storage("ends of pages", PAGE_BYTES * (len(pages) + 1))
        self.tally = self._storage("tally of keys", 4 * BINS)
        self.origins = self._storage("origins", 4 * capacity)
        self.takers = self._storage("takers", VEC4 * capacity if with_ids else 0)
        self._row_origins = list[Buffer]()
        if origins is not None:
            self._row_origins = [self._origins_of(slot, origins) for slot in range(len(pages))]

    def _storage(self, name: str, size: int) -> Buffer:
        self.buffers[name] = self._device.storage(name, size)
        return self.buffers[name]

    def _origins_of(self, slot: int, origins: np.ndarray) -> Buffer:
        first = sum(page.capacity for page in self._pages[:slot])
        count = self._pages[slot].capacity
        buffer = self._storage(f"origins of page {slot}", 4 * count)
        self._device.write(buffer, origins[first : first + count])
        return buffer

    def _choose(self, low: int, high: int, shift: int = 0) -> None:
        """Set the range of depth sort keys that the next dispatches count or draw."""
        self._device.write(self._range, np.array([low, high, shift, 0], np.uint32))

    def draw(self, stages: Sequence[str], run: Run) -> Drawing:
        """Draw all depth slabs, and return the summed GPU counters and the images.

        Args:
            stages: Names of the stages that draw one slab.
            run: Runs stages of the plan.

        Raises:
            CapacityExceeded: More splats have one depth than a slab holds.
        """
        key_stages = list(KEY_STAGES)

        def tally(low: int, shift: int) -> np.ndarray:
            self._choose(low, low + (BINS << shift), shift)
            run(key_stages, resumes=False, continues=True)
            key_stages[:] = KEY_STAGES[1:]  # the keys stay the same
            return self._device.read(self.tally, np.uint32, BINS)

        ranges, total = slab_ranges(tally, self.capacity), np.zeros(0, np.uint32)
        for number, (low, high) in enumerate(ranges):
            self._choose(low, high)
            continues = number + 1 < len(ranges)
            counts, images = run(stages, resumes=number > 0, continues=continues)
            total = counts if number == 0 else _total(total, counts)
            if total[_REDRAWN].any() or total[Counts.WANTED_PAIRS] > total[Counts.PAIR_CAPACITY]:
                break  # the frame is drawn again
        return total, images

    def key_steps(
        self, outputs: tuple[Buffer, ...], uniform: Buffer, *, panorama: bool
    ) -> list[Step]:
        """Return the dispatches that compute the depth sort keys of all Gaussians.

        Args:
            outputs: The outputs of the projection, in order.
            uniform: Buffer with the uniforms of all pages.
            panorama: Whether the image is a panorama.
        """
        return [
            self._kernels.project(
                page.half, page.stride, panorama, page.packed, 0, False, "keys"
            ).step((outputs[0], keys, *outputs[2:]), uniform, slot, page)
            for slot, (page, keys) in enumerate(zip(self._pages, self._keys, strict=True))
        ]

    def tally_steps(self, uniform: Buffer) -> list[Step]:
        """Return the dispatches that count the depth sort keys in the chosen range."""
        kernel = self._kernels.tally()
        return [
            kernel.step(self._range, keys, self.tally, uniform, slot, page)
            for slot, (page, keys) in enumerate(zip(self._pages, self._keys, strict=True))
        ]

    def project_steps(
        self,
        outputs: tuple[Buffer, ...],
        counts: Buffer,
        uniform: Buffer,
        normals: Buffer | None,
        *,
        panorama: bool,
        records: bool,
    ) -> list[Step]:
        """Return the dispatches that project the Gaussians in the chosen range of depths.

        Args:
            outputs: The outputs of the projection, in order.
            counts: The frame's counts.
            uniform: Buffer with the uniforms of all pages.
            normals: Buffer of normals; None if they are not requested.
            panorama: Whether the image is a panorama.
            records: Whether each splat is one record.
        """
        numbering = self._kernels.place(bool(self._row_origins))
        steps = []
        for slot, (page, keys) in enumerate(zip(self._pages, self._keys, strict=True)):
            row_origins = self._row_origins[slot] if self._row_origins else keys
            resources = (self._range, keys, self._block_counts, self._places, row_origins)
            written = (self.origins, self.takers, counts)
            steps += numbering.steps((*resources, *written), self._ends, uniform, slot, page)
            project = self._kernels.project(
                page.half, page.stride, panorama, page.packed, 0, records, "splats"
            )
            steps.append(project.step(outputs, uniform, slot, page, self._places))
            if normals is not None:
                kernel = self._kernels.normals(page.packed, 0, True)
                steps.append(kernel.step(self._places, normals, uniform, slot, page))
        return steps
