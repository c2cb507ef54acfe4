"""Records the renderer's GPU work for a frame, on a device that computes nothing."""

__all__ = [
    "APPEARANCES",
    "Appearance",
    "RecordedPlan",
    "Shape",
    "page_kind",
    "record",
    "recorded_pages",
    "recorded_pool_pages",
]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from gsgen.contract.spec.layout import ROW_LENGTH
from gsgen.contract.spec.manifest import WeightedSum
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Page, allocate_pool_page, appearance_stride
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.renderer.placed_pages import PlacedPage
from gsgen.runtime.renderer.plan_options import ImageSpec, RasterMethod
from gsgen.runtime.scene.frame import Output
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import SLOT_ROWS, SplatPool
from web_client.formulas import Formula, Tree, tree_of
from web_client.recording_device import RecordedBuffer, RecordingDevice


@final
@dataclass(frozen=True, slots=True)
class Appearance:
    """The format of SH coefficients or colours in a GPU buffer: dtype, row stride and channels.

    Attributes:
        half: Whether they are float16.
        stride: Length of a row, in vectors of 16 bytes; 0 if two rows share one.
        channels: The most numbers of a Gaussian that such a row has.
    """

    half: bool
    appearance_stride: int
    channels: int


APPEARANCES: Final = tuple(
    Appearance(half, appearance_stride(channels, is_half=half), channels)
    for half, sizes in ((False, (4, 12, 27, 48)), (True, (4, 12, 27, 48)))
    for channels in sizes
)
"""RGB (three channels, or four), and SH of degree 1 to 3; degree 0 is stored like RGB."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """The options that decide the GPU work of a frame: outputs, projection, sort and image size.

    Attributes:
        outputs: The images that it draws.
        panorama: Whether it draws panoramas.
        deep: Whether its depth sort is deep.
        weighted: Whether it draws sets by weighted-sum rendering instead of sorting Gaussians.
        layers: Image layers among the Gaussians that the page writes.
        size: Width and height of an image that needs the plan's passes of the tile sort.
        slot_rows: Rows of a slot of splat pools.
    """

    outputs: tuple[Output, ...]
    panorama: bool = False
    deep: bool = False
    weighted: bool = False
    layers: int = 0
    size: tuple[int, int] = (64, 64)
    slot_rows: int = SLOT_ROWS


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedPlan:
    """A recorded frame plan (GPU buffers and dispatches), and the sizes in its formulas.

    Attributes:
        shape: The shape.
        plan: The plan, whose buffers and steps are recordings.
        pages: Its pages: one for each appearance, and one more like the first. Then as many of
            splat pools, except among weighted sets.
        guards: Conditions on the sizes under which the plan has these steps.
        sizes: The recorded value of each size of the plan.
        totals: The formula of each sum over pages, by name: of ``gaussians``, and of ``cells``.
    """

    shape: Shape
    plan: Plan
    pages: tuple[Page, ...]
    guards: list[Tree]
    sizes: dict[str, int]
    totals: dict[str, Tree]


# No number that a plan writes equals these, or a sum of capacities, by chance.
_PAIRS: Final = 1_610_612_741
_CAPACITY: Final = 1_000_003
_CELLS: Final = 500_009
_SLOTS: Final = 101


def record(shape: Shape) -> RecordedPlan:
    """Record the GPU work of a frame with given outputs, projection, sort and image size."""
    guards: list[Tree] = []
    names = {"width": shape.size[0], "height": shape.size[1], "pairs": _PAIRS}
    width, height, pairs = (Formula(value, name, guards) for name, value in names.items())
    kinds = (*APPEARANCES, APPEARANCES[0])
    capacities, cell_counts, slots = (
        [
            Formula(first + step * index, f"{name} {number}", guards)
            for index, number in enumerate(range(first_page, first_page + len(kinds)))
        ]
        for name, first, step, first_page in (
            ("capacity", _CAPACITY, 7_919, 0),
            ("cells", _CELLS, 7_919, 0),
            ("slots", _SLOTS, 1, len(kinds)),
        )
    )
    device = Device(RecordingDevice())
    placed = recorded_pages(kinds, capacities, cell_counts if shape.weighted else None)
    if not shape.weighted:
        placed += recorded_pool_pages(device, kinds, slots, shape.slot_rows)
    image = ImageSpec(
        size=(width, height),
        outputs=frozenset(shape.outputs),
        projection="panorama" if shape.panorama else "plane",
    )
    method = RasterMethod(pair_capacity=pairs, sort="deep" if shape.deep else "by key")
    plan = Plan(Kernels(device, is_single_shape=True), placed, image, method, layers=shape.layers)
    gaussians = sum(page.capacity for _, page in placed)
    totals = {"gaussians": gaussians, "cells": sum(cell_counts)}
    return RecordedPlan(
        shape=shape,
        plan=plan,
        pages=tuple(page for _, page in placed),
        guards=guards,
        sizes=names | {name: int(total) for name, total in totals.items()},
        totals={name: tree_of(total) for name, total in totals.items()},
    )


def recorded_pages(
    kinds: Sequence[Appearance], capacities: Sequence[int], cells: Sequence[int] | None = None
) -> list[PlacedPage]:
    """Return placeholder GPU buffers of splat sets: one per colour format and number of rows.

    Args:
        kinds: The format of each page's appearance.
        capacities: The number of rows of each page.
        cells: The number of cells of each set, for weighted-sum rendering.
    """
    rows = np.zeros((0, ROW_LENGTH), np.float32)
    empty = SplatData(rows, np.zeros((0, 3), np.float32), "rgb", cells=rows)
    splat_set = SplatSet(empty, weighted=None if cells is None else WeightedSum(background=1))
    return [
        (
            splat_set,
            Page(
                first=0,
                capacity=capacity,
                rows=_page_buffer("rows", 4 * ROW_LENGTH * capacity),
                appearance=_page_buffer(
                    "appearance", (16 * kind.appearance_stride or 8) * capacity
                ),
                is_half=kind.half,
                appearance_stride=kind.appearance_stride,
                cells=None
                if cells is None
                else RecordedBuffer("cells", 4 * ROW_LENGTH * cells[slot], 0),
            ),
        )
        for slot, (kind, capacity) in enumerate(zip(kinds, capacities, strict=True))
    ]


def recorded_pool_pages(
    device: Device, kinds: Sequence[Appearance], slots: Sequence[int], slot_rows: int = SLOT_ROWS
) -> list[PlacedPage]:
    """Return placeholder GPU buffers of splat pools (streamed tiles): one per colour format."""
    empty = SplatSet(
        SplatData(np.zeros((0, ROW_LENGTH), np.float32), np.zeros((0, 3), np.float32), "sh")
    )
    placed = []
    for kind, count in zip(kinds, slots, strict=True):
        # A pool has harmonics, of degree 0 three numbers.
        pool = SplatPool(slot_rows, 3 if kind.channels == 4 else kind.channels, slot_rows=slot_rows)
        placed.append((empty, allocate_pool_page(device, pool, 0, count, is_half=kind.half)))
    return placed


def page_kind(page: Page) -> str:
    """Return a key for the layout of splats in GPU buffers: dtype, stride, streamed pool or not.

    The key of float16 colours with a stride of 16 in a pool is ``pool of float16 16``.
    """
    name = f"{'float16' if page.is_half else 'float32'} {page.appearance_stride}"
    return name if page.slots is None else f"pool of {name}"


def _page_buffer(label: str, size: int) -> RecordedBuffer:
    return RecordedBuffer(label, -(-size // 16) * 16, 0)
