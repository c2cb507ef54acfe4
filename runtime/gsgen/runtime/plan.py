"""A plan: all buffers and dispatches of a frame, made once and run every frame."""

__all__ = ["Kernels", "Plan"]

from collections.abc import Sequence
from functools import cache
from typing import Any, Final, final

import numpy as np

from gsgen.runtime.camera import Camera
from gsgen.runtime.device import Device
from gsgen.runtime.kernels import counts as counting
from gsgen.runtime.kernels.bin_tiles import (
    RANGE_THREADS,
    WALK_THREADS,
    BinTiles,
    TileRanges,
)
from gsgen.runtime.kernels.blend_tiles import BlendTiles
from gsgen.runtime.kernels.counts import Counts
from gsgen.runtime.kernels.kernel import Step, run
from gsgen.runtime.kernels.project import (
    FRAME,
    PAGE,
    ProjectKernel,
    frame_uniform,
    page_uniform,
    tiles_of,
)
from gsgen.runtime.kernels.sort import KEY_BITS, RadixSort, Scan, cut_for
from gsgen.runtime.residency import Page, stride
from gsgen.runtime.scene import SplatSet

_VEC4: Final = 16


@final
class Kernels:
    """The kernels of a device; those that depend on a layout are made when one is met."""

    def __init__(self, device: Device) -> None:
        self.cut = cut_for(device)
        self.scan = Scan(device, self.cut, WALK_THREADS * self.cut.walk, RANGE_THREADS)
        self.sort = RadixSort(device, self.cut, self.scan)
        self.bin = BinTiles(device, self.cut)
        self.ranges = TileRanges(device)
        self.blend = BlendTiles(device, pick=False)
        self.project = cache(lambda *layout: ProjectKernel(device, *layout))


@final
class Plan:
    """The frame of a list of pages at one size of image.

    Args:
        device: Where it runs.
        kernels: Of the device.
        pages: Each page with the set that it is of; only their buffers are used here.
        size: Width and height of the image, in pixels.
        pair_capacity: For how many pairs of a splat and a tile there is room.
    """

    def __init__(
        self,
        device: Device,
        kernels: Kernels,
        pages: Sequence[tuple[SplatSet, Page]],
        size: tuple[int, int],
        pair_capacity: int,
    ) -> None:
        self._device = device
        self.size = size
        self.pair_capacity = pair_capacity
        self.gaussians = sum(page.capacity for _, page in pages)
        n, storage = self.gaussians, device.storage
        self.counts = storage("counts", counting.BYTES, extra="INDIRECT")
        device.write(self.counts, counting.initial(n, pair_capacity))
        self.frame = device.uniform("frame", FRAME.itemsize)
        self.slots = device.uniform("pages", PAGE.itemsize * max(1, len(pages)))
        self.touched = storage("touched", 4 * n)
        self.shapes = storage("shapes", _VEC4 * n)
        self.weights = storage("weights", _VEC4 * n)
        self.colors = storage("colors", _VEC4 * n)
        self.image = storage("image", _VEC4 * size[0] * size[1])
        self.steps = self._steps(kernels, pages)

    def _steps(
        self, kernels: Kernels, pages: Sequence[tuple[SplatSet, Page]]
    ) -> dict[str, list[Step]]:
        """Record the frame, stage by stage."""
        n, storage, counts = self.gaussians, self._device.storage, self.counts
        keys = [
            (storage(f"keys {side}", 4 * n), storage(f"values {side}", 4 * n))
            for side in "ab"
        ]
        project = self._project(kernels, pages, keys[0][0])
        by_depth, at = kernels.sort.steps(
            counts,
            kernels.sort.histogram(n),
            keys,
            bits=KEY_BITS,
            source=Counts.VISIBLE,
            groups=Counts.SORT_VISIBLE_GROUPS,
            capacity=n,
            compacted=Counts.VISIBLE,
        )
        order = keys[at][1]
        room = self.pair_capacity
        pairs = [
            (storage(f"pair tiles {side}", 4 * room), storage(f"pair splats {side}", 4 * room))
            for side in "ab"
        ]
        run_pairs = storage("run pairs", 4 * (-(-n // kernels.cut.walk)))
        splats = (self.shapes, self.weights, self.colors)
        measure, emit = kernels.bin.steps(
            counts, self.frame, order, self.touched, self.shapes, self.weights, run_pairs, *pairs[0]
        )
        add = kernels.scan.step(
            counts,
            run_pairs,
            source=Counts.VISIBLE,
            block=kernels.cut.walk,
            total=Counts.PAIRS,
        )
        across, down = -(-self.size[0] // 16), -(-self.size[1] // 16)
        by_tile, at = kernels.sort.steps(
            counts,
            kernels.sort.histogram(room),
            pairs,
            bits=max(1, (across * down - 1).bit_length()),
            source=Counts.PAIRS,
            groups=Counts.SORT_PAIRS_GROUPS,
        )
        self.ranges = storage("ranges", 8 * across * down)
        mark = kernels.ranges.step(counts, pairs[at][0], self.ranges)
        self.pair_splats = pairs[at][1]
        blend = kernels.blend.step(
            (across, down), self.frame, self.ranges, pairs[at][1], *splats, self.image
        )
        return {
            "project": project,
            "sort": by_depth,
            "bin": [measure, add, emit],
            "group": [*by_tile, mark],
            "blend": [blend],
        }

    def _project(
        self, kernels: Kernels, pages: Sequence[tuple[SplatSet, Page]], keys: Any
    ) -> list[Step]:
        made = []
        outputs = (self.frame, keys, self.touched, self.shapes, self.weights, self.colors)
        for slot, (placed, page) in enumerate(pages):
            data = placed.data
            one = kernels.project(
                data.appearance.dtype == np.float16, stride(data)
            )
            own = one.bind_page(self.slots, slot, page.rows, page.appearance)
            made.append(
                Step(one.kernel, (one.kernel.bind(*outputs), own), one.groups(page.capacity))
            )
        return made

    def submit(
        self,
        pages: Sequence[tuple[SplatSet, Page]],
        camera: Camera,
        background: np.ndarray,
        only: Sequence[str] = (),
    ) -> None:
        """Write what changes from frame to frame, and let the device draw."""
        self._device.write(self.frame, frame_uniform(camera, background))
        slots = np.zeros(max(1, len(pages)), PAGE)
        base = 0
        for slot, (placed, page) in enumerate(pages):
            live = min(max(placed.data.count - page.first, 0), page.capacity)
            slots[slot] = page_uniform(placed, camera, base, page.capacity, live)
            base += page.capacity
        self._device.write(self.slots, slots)
        encoder = self._device.raw.create_command_encoder(label="frame")
        encoder.clear_buffer(self.ranges)
        for stage, steps in self.steps.items():
            if not only or stage in only:
                run(encoder, steps, stage)
        self._device.raw.queue.submit([encoder.finish()])
