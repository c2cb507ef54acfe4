"""The GPU pages (buffers) of a scene with their splat sets, in drawing order."""

__all__ = [
    "PlacedPage",
    "scene_order",
    "scene_pages",
    "settings_set",
    "slot_rows",
    "sorted_pages",
    "weighted_pages",
    "write_pages",
]

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt32

from gsgen.contract.spec import layout
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import Page, Residency
from gsgen.runtime.kernels.project.project import page_uniforms
from gsgen.runtime.kernels.project.slots import slot_table
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import PooledSplatSet

PlacedPage = tuple[SplatSet, Page]
"""A splat set with one of its pages (GPU buffers)."""


def scene_order(placed: Sequence[PlacedPage]) -> UInt32[np.ndarray, " n"] | None:
    """Return each Gaussian's index in the scene, in GPU buffer order; None if both orders agree."""
    if all(page.rows_of is None for _, page in placed):
        return None
    page_parts, base = [], 0
    for _, page in placed:
        row_indices = np.arange(page.first, page.first + page.capacity)
        page_parts.append(
            (row_indices if page.rows_of is None else page.rows_of) + (base - page.first)
        )
        base += page.capacity
    return np.concatenate(page_parts).astype(np.uint32)


def scene_pages(scene: Scene, residency: Residency) -> list[PlacedPage]:
    """Return the GPU buffers (pages) of the splat sets of a scene, after uploading changes."""
    sets = [(entry, page) for entry in scene.sets for page in residency.pages(entry.data)]
    return sets + [
        (settings_set(pooled), page)
        for pooled in scene.pools
        for page in residency.pool_pages(pooled.pool)
    ]


def slot_rows(page: Page) -> int:
    """Return the number of rows in a slot of the page's splat pool; 0 for a page without a pool."""
    return 0 if page.slots is None else page.slots.slot_rows


def weighted_pages(placed: Sequence[PlacedPage]) -> list[PlacedPage]:
    """Return the pages (GPU buffers) of splat sets that are blended by weighted sums."""
    return [(splat_set, page) for splat_set, page in placed if splat_set.weighted is not None]


def sorted_pages(placed: Sequence[PlacedPage]) -> list[PlacedPage]:
    """Return the pages (GPU buffers) of splat sets that are sorted by depth."""
    return [(splat_set, page) for splat_set, page in placed if splat_set.weighted is None]


def write_pages(
    device: Device,
    placed: Sequence[PlacedPage],
    camera: Camera,
    uniform: Buffer,
    right: Camera | None = None,
) -> None:
    """Write a frame's uniforms of the pages (GPU buffers) of sorted sets, and their slot tables.

    Args:
        device: Device of the buffers.
        placed: The pages.
        camera: Camera of the frame.
        uniform: Receives the uniforms of all pages.
        right: Camera of the right eye, if ``camera`` is that of the left one.
    """
    pages, base = list[tuple[SplatSet, int, int, int]](), 0
    for splat_set, page in placed:
        live_rows = min(max(splat_set.data.count - page.first, 0), page.capacity)
        if page.slots is not None:
            slots, live_rows = page.slots, page.capacity
            table = slot_table(slots.pool, slots.first, slots.count, splat_set.transform, camera)
            device.write(slots.table, table)
        pages.append((splat_set, base, page.capacity, live_rows))
        base += page.capacity
    device.write(uniform, page_uniforms(pages, camera, right))


def settings_set(pooled: PooledSplatSet) -> SplatSet:
    """Return an empty splat set that has the drawing settings of a splat pool (streamed tiles)."""
    pool = pooled.pool
    rows = np.zeros((0, layout.ROW_LENGTH), np.float32)
    data = SplatData(rows, np.zeros((0, pool.channels), np.float32), "sh")
    return SplatSet(
        data,
        pooled.transform,
        opacity_scale=pooled.opacity_scale,
        degree=pooled.degree,
        antialias=pooled.antialias,
    )
