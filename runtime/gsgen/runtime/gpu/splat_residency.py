"""Keeps Gaussians of splat sets in GPU buffers, split into pages that fit buffer bindings."""

__all__ = [
    "GPU_PAGE_ROWS",
    "PAGE_ROWS",
    "PAGE_SLOTS",
    "SLOT_BYTES",
    "Page",
    "PageSlots",
    "Residency",
    "allocate_pool_page",
    "appearance_stride",
    "bytes_of",
    "is_larger_than_binding",
]

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, NamedTuple, final
from weakref import ReferenceType, WeakKeyDictionary, ref

import numpy as np
from jaxtyping import Float, Float32, UInt32

from gsgen.contract.spec import layout
from gsgen.runtime.gpu.compact_rows import PACKED_BYTES, pack_rows
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.spatial_order import MIN_ORDERED_ROWS, SpatialOrder
from gsgen.runtime.gpu.upload import Target, upload
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import SplatPool

PAGE_ROWS: Final = 1 << 18
"""Gaussians of a page (GPU buffers): degree-3 SH take 48 of the 128 MiB that devices bind."""

GPU_PAGE_ROWS: Final = 2 * PAGE_ROWS
"""Gaussians of a page (GPU buffers) on a hardware GPU, where dispatches wait for each other."""

SLOT_BYTES: Final = 96
"""Bytes of a row in the table of tile slots, ``struct Slot`` in slots.wgsl."""

PAGE_SLOTS: Final = 64
"""Most tile slots in a page (GPU buffer) of a pool: every device binds uniforms of 64 KiB."""

_VECTOR_BYTES: Final = 16


def appearance_stride(channels: int, *, is_half: bool) -> int:
    """Return the size of a Gaussian's colour coefficients on the GPU, in vectors of 16 bytes.

    Shaders read whole vectors, so rows are padded to them; 0 means that two rows share one.
    """
    size = channels * (2 if is_half else 4)
    return 0 if size <= _VECTOR_BYTES // 2 else -(-size // _VECTOR_BYTES)


def bytes_of(data: SplatData, *, compact: bool) -> int:
    """Return the bytes of GPU memory of a splat set: Gaussians, colours, groups of Gaussians."""
    is_half = compact or data.appearance.dtype == np.float16
    row = _bytes_of_row(packed=compact and data.cells is None)
    row += _bytes_of_appearance(appearance_stride(data.appearance.shape[1], is_half=is_half))
    cells = 0 if data.cells is None else 4 * layout.ROW_LENGTH * len(data.cells)
    return len(data) * row + cells


def is_larger_than_binding(device: Device, data: SplatData) -> bool:
    """Return whether the cells of a splat set take more than one GPU binding."""
    return (
        data.cells is not None and 4 * layout.ROW_LENGTH * len(data.cells) > device.largest_binding
    )


def _bytes_of_row(*, packed: bool) -> int:
    return PACKED_BYTES if packed else 4 * layout.ROW_LENGTH


def _bytes_of_appearance(appearance_stride: int) -> int:
    return _VECTOR_BYTES * appearance_stride or _VECTOR_BYTES // 2


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PageSlots:
    """Slots (row ranges for streamed tiles) in one page (GPU buffers) of the splat pool.

    Attributes:
        pool_reference: Weak reference to the pool, whose memory is freed when no scene has it.
        first: Index of the page's first slot in the pool.
        count: Number of slots.
        slot_rows: Number of rows in a slot.
        table: Buffer of the slot table.
        seen: Buffer of the slots that may be seen.
        dispatch: Buffer of the indirect dispatch that projects them.
    """

    pool_reference: ReferenceType[SplatPool]
    first: int
    count: int
    slot_rows: int
    table: Buffer
    seen: Buffer
    dispatch: Buffer

    @property
    def pool(self) -> SplatPool:
        """The splat pool (GPU memory for streamed tiles) of the page; a scene has to hold it."""
        pool = self.pool_reference()
        assert pool is not None
        return pool


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Page:
    """Consecutive Gaussians of one splat set, in GPU buffers that are small enough to be bound.

    Attributes:
        first: Index of the page's first row in the set.
        capacity: Number of rows.
        rows: Buffer of rows.
        appearance: Buffer of SH coefficients or colours.
        is_half: Whether the appearance is float16.
        appearance_stride: Length of an appearance row, see :func:`appearance_stride`.
        packed: Whether rows are packed into 32 bytes (compact_rows.py).
        cells: Buffer of all cells of the set, or of those of the page if all exceed a binding;
            None without cells.
        first_cell: Index in the set of the first cell in ``cells``.
        rows_of: Index in the set of each row of the page; None if rows keep their own order.
        slots: Slots of the page, if it belongs to a pool.
    """

    first: int
    capacity: int
    rows: Buffer
    appearance: Buffer
    is_half: bool
    appearance_stride: int
    packed: bool = False
    cells: Buffer | None = None
    first_cell: int = 0
    rows_of: UInt32[np.ndarray, " n"] | None = None
    slots: PageSlots | None = None


def allocate_pool_page(
    device: Device, pool: SplatPool, first: int, count: int, *, is_half: bool
) -> Page:
    """Allocate the GPU buffers of consecutive slots of a splat pool, for streamed tiles.

    Args:
        device: Device of the buffers.
        pool: The pool.
        first: Index of the page's first slot.
        count: Number of slots, at most ``PAGE_SLOTS``; it may be a recorded size.
        is_half: Whether the appearance is float16.
    """
    appearance_words = appearance_stride(pool.channels, is_half=is_half)
    capacity = count * pool.slot_rows
    dispatch = device.storage("dispatch of a pool", 12, extra_usage="INDIRECT")
    device.write(dispatch, np.array([0, 1, 1], np.uint32))
    return Page(
        first=first * pool.slot_rows,
        capacity=capacity,
        rows=device.storage("rows of a pool", _bytes_of_row(packed=False) * capacity),
        appearance=device.storage(
            "appearance of a pool", _bytes_of_appearance(appearance_words) * capacity
        ),
        is_half=is_half,
        appearance_stride=appearance_words,
        slots=PageSlots(
            pool_reference=ref(pool),
            first=first,
            count=count,
            slot_rows=pool.slot_rows,
            table=device.uniform("slot table", SLOT_BYTES * PAGE_SLOTS),
            seen=device.storage("slots in view", 4 * PAGE_SLOTS, extra_usage="UNIFORM"),
            dispatch=dispatch,
        ),
    )


def _rows_target(page: Page, first: int, rows: Float[np.ndarray, "n 10"]) -> Target:
    convert = pack_rows if page.packed else None if rows.dtype == np.float32 else _to_float32
    return Target(page.rows, first, _bytes_of_row(packed=page.packed), convert)


def _to_float32(rows: Float[np.ndarray, "n 10"]) -> Float32[np.ndarray, "n 10"]:
    return rows.astype(np.float32)


def _appearance_target(page: Page, first: int, appearance: Float[np.ndarray, "n c"]) -> Target:
    dtype = np.dtype(np.float16 if page.is_half else np.float32)
    size = _bytes_of_appearance(page.appearance_stride)
    is_same_layout = appearance.dtype == dtype and size == appearance.strides[0]
    convert = None if is_same_layout else partial(_convert_appearance, dtype=dtype, size=size)
    return Target(page.appearance, first, size, convert)


def _convert_appearance(
    appearance: Float[np.ndarray, "n c"], dtype: np.dtype[Any], size: int
) -> Float[np.ndarray, "n d"]:
    """Convert the appearance of Gaussians to a dtype, with rows padded by zeros to a fixed size."""
    converted_appearance = np.zeros((len(appearance), size // dtype.itemsize), dtype)
    with np.errstate(over="ignore"):  # overflows become infinite, and such Gaussians are not drawn
        converted_appearance[:, : appearance.shape[1]] = appearance
    return converted_appearance


@final
@dataclass(slots=True, eq=False)
class _UploadedPart:
    """The uploaded part of an array: the array's version, and the number of uploaded rows."""

    version: int = -1
    rows: int = 0

    def missing(self, version: int, live_rows: int) -> Iterator[slice]:
        """Yield the slice of an array's used rows that is not uploaded yet; mark it as uploaded."""
        first = self.rows if self.version == version else 0
        if live_rows > first:
            yield slice(first, live_rows)
        self.version, self.rows = version, max(first, live_rows)


@final
class _SetVersions(NamedTuple):
    """The versions of a splat set's arrays and its number of Gaussians, at the start of a frame."""

    rows: int
    appearance: int
    live_rows: int


@final
@dataclass(slots=True, eq=False, kw_only=True)
class _ResidentSplats:
    """The pages (GPU buffers) of one ``SplatData``, and the uploaded part of each of its arrays.

    Attributes:
        state: Versions at the start of the last frame.
        order: Spatial order of the rows; None if they keep their own order.
        skips_reordering: Whether the rows keep their own order for good.
    """

    pages: list[Page]
    rows: _UploadedPart
    appearance: _UploadedPart
    cells: _UploadedPart
    state: _SetVersions | None = None
    order: SpatialOrder | None = None
    skips_reordering: bool = False


def _page_slices(pages: list[Page], live_rows: slice) -> Iterator[tuple[Page, slice, int]]:
    """Yield each page (GPU buffers) with its rows of a slice, and their offset in the page."""
    for page in pages:
        first = max(live_rows.start, page.first)
        last = min(live_rows.stop, page.first + page.capacity)
        if first < last:
            yield page, slice(first, last), first - page.first


@final
class Residency:
    """Keeps the pages (GPU buffers) of each ``SplatData`` for as long as that object exists.

    Args:
        device: Device of the buffers.
        page_rows: Most rows of a page.
        compact: Whether appearance is float16 and rows are packed, except in sets with cells.
    """

    def __init__(
        self, device: Device, page_rows: int | None = None, *, compact: bool = False
    ) -> None:
        if page_rows is None:
            page_rows = PAGE_ROWS if device.software else GPU_PAGE_ROWS
        self._is_compact = compact
        self._device = device
        self._page_rows = page_rows
        self._resident_by_splat_data: WeakKeyDictionary[SplatData, _ResidentSplats]
        self._resident_by_splat_data = WeakKeyDictionary()
        self._pools: WeakKeyDictionary[SplatPool, list[Page]] = WeakKeyDictionary()

    def begin(self, data: SplatData) -> None:
        """Prepare a splat set for a frame; from its second frame on, rows may be in Morton order.

        Neighbours in memory are then read together by a tile, which nearly halves the time of a
        frame of a million Gaussians. Rows that change keep the order of an earlier frame if they
        are written to mapped memory, where any order costs the same. On other devices, and in
        sets whose count changes, rows return to their own order for good.
        """
        resident = self._resident_splats(data)
        new_versions = _SetVersions(data.rows_version, data.appearance_version, data.count)
        if resident.state is not None:
            self._update_layout(data, resident, resident.state, new_versions)
        resident.state = (
            new_versions  # only now: after an error for lack of memory, the next frame follows
        )

    def _update_layout(
        self,
        data: SplatData,
        resident: _ResidentSplats,
        old_versions: _SetVersions,
        new_versions: _SetVersions,
    ) -> None:
        """Choose the order and the packing of Gaussians by the changes since the last frame."""
        has_new_rows = old_versions.rows != new_versions.rows
        if has_new_rows:
            self._store_unpacked(resident)
        if old_versions != new_versions and not (
            self._device.maps_buffers and old_versions.live_rows == new_versions.live_rows
        ):
            if resident.order is not None:
                self.restore_order(data)
        elif resident.skips_reordering or len(data) < MIN_ORDERED_ROWS or data.cells is not None:
            return
        elif resident.order is None or (
            has_new_rows and not resident.order.is_valid_after_change(data)
        ):
            self._set_row_order(resident, SpatialOrder.of(data))

    def restore_order(self, data: SplatData) -> None:
        """Store the rows of a splat set in their original order on the GPU from now on."""
        resident = self._resident_splats(data)
        resident.skips_reordering = True
        self._set_row_order(resident, None)

    def _store_unpacked(self, resident: _ResidentSplats) -> None:
        """Store changing Gaussians unpacked on the GPU: packing them takes longer than a frame."""
        if any(page.packed for page in resident.pages):
            size = _bytes_of_row(packed=False)
            resident.rows = _UploadedPart()
            resident.pages = [
                replace(
                    page,
                    packed=False,
                    rows=self._device.dynamic_storage("rows", size * page.capacity),
                )
                for page in resident.pages
            ]

    def _set_row_order(self, resident: _ResidentSplats, order: SpatialOrder | None) -> None:
        """Set the order of a splat set's rows in GPU memory, and upload all rows again."""
        resident.order = order
        resident.rows, resident.appearance = _UploadedPart(), _UploadedPart()
        resident.pages = [
            replace(
                page,
                rows_of=None
                if order is None
                else order.rows[page.first : page.first + page.capacity],
            )
            for page in resident.pages
        ]

    def _resident_splats(self, data: SplatData) -> _ResidentSplats:
        if data not in self._resident_by_splat_data:
            self._resident_by_splat_data[data] = _ResidentSplats(
                pages=list(self._allocate(data)),
                rows=_UploadedPart(),
                appearance=_UploadedPart(),
                cells=_UploadedPart(),
            )
        return self._resident_by_splat_data[data]

    def pages(self, data: SplatData) -> list[Page]:
        """Return the pages (GPU buffers) of a splat set, after uploading changed rows."""
        resident = self._resident_splats(data)
        for live_rows in resident.rows.missing(data.rows_version, data.count):
            self._upload(resident, live_rows, data.rows, _rows_target)
        for live_rows in resident.appearance.missing(data.appearance_version, data.count):
            self._upload(resident, live_rows, data.appearance, _appearance_target)
        self._write_cells(data, resident)
        return resident.pages

    def pool_pages(self, pool: SplatPool) -> list[Page]:
        """Return the pages (GPU buffers) of a pool of streamed tiles, after uploading new tiles.

        Writes of the queue come before the next frame and after all earlier ones, so that no frame
        in flight reads a slot that is written.
        """
        if pool not in self._pools:
            self._pools[pool] = list(self._allocate_pool(pool))
        pages = self._pools[pool]
        rows_per_page = pages[0].capacity
        for write in pool.take_writes():
            page = pages[write.first // rows_per_page]
            first = write.first - page.first
            size = _bytes_of_row(packed=False)
            self._device.write(page.rows, write.rows.astype(np.float32), first * size)
            upload_target = _appearance_target(page, first, write.appearance)
            appearance = (
                write.appearance
                if upload_target.convert is None
                else upload_target.convert(write.appearance)
            )
            self._device.write(page.appearance, appearance, first * upload_target.size)
        return pages

    def _allocate_pool(self, pool: SplatPool) -> Iterator[Page]:
        slots_per_page = min(PAGE_SLOTS, max(1, self._page_rows // pool.slot_rows))
        for first in range(0, pool.slots, slots_per_page):
            count = min(slots_per_page, pool.slots - first)
            yield allocate_pool_page(self._device, pool, first, count, is_half=self._is_compact)

    def _upload(
        self,
        resident: _ResidentSplats,
        live_rows: slice,
        array: Float[np.ndarray, "n c"],
        target: Callable[[Page, int, np.ndarray], Target],
    ) -> None:
        """Write a slice of an array's rows into the GPU buffers (pages) that hold the array."""
        for page, part, first in _page_slices(resident.pages, live_rows):
            upload_target = target(page, first, array)
            if resident.order is None:
                upload(self._device, upload_target, array[part])
            else:
                upload(self._device, upload_target, array, resident.order.rows[part])

    def _write_cells(self, data: SplatData, resident: _ResidentSplats) -> None:
        if data.cells is None or not resident.pages:
            return
        size, convert = (
            _bytes_of_row(packed=False),
            None if data.cells.dtype == np.float32 else _to_float32,
        )
        for _ in resident.cells.missing(data.cells_version, len(data.cells)):
            for buffer, first in {page.cells: page.first_cell for page in resident.pages}.items():
                assert buffer is not None
                part = data.cells[first : first + buffer.size // size]
                upload(self._device, Target(buffer, 0, size, convert), part)

    def _allocate(self, data: SplatData) -> Iterator[Page]:
        is_half = self._is_compact or data.appearance.dtype == np.float16
        appearance_words = appearance_stride(data.appearance.shape[1], is_half=is_half)
        packed = self._is_compact and data.cells is None
        cells, first_cell, is_paged = None, 0, False
        if data.cells is not None:
            is_paged = is_larger_than_binding(self._device, data)
            if not is_paged:
                cells = self._cells(len(data.cells))
        for first in range(0, len(data), self._page_rows):
            capacity = min(self._page_rows, len(data) - first)
            if is_paged:  # a cell that two pages share is in both
                first_cell = first // data.per_cell
                cells = self._cells((first + capacity - 1) // data.per_cell + 1 - first_cell)
            yield Page(
                first=first,
                capacity=capacity,
                rows=self._device.dynamic_storage("rows", capacity * _bytes_of_row(packed=packed)),
                appearance=self._device.dynamic_storage(
                    "appearance", capacity * _bytes_of_appearance(appearance_words)
                ),
                is_half=is_half,
                appearance_stride=appearance_words,
                packed=packed,
                cells=cells,
                first_cell=first_cell,
            )

    def _cells(self, count: int) -> Buffer:
        return self._device.dynamic_storage("cells", 4 * layout.ROW_LENGTH * count)
