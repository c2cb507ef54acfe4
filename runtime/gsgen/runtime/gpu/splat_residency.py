"""Splat residency: the rows of every set on the GPU, in pages no larger than a binding."""

__all__ = ["PAGE_ROWS", "Page", "Residency", "bytes_of", "stride"]

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, NamedTuple, final
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Float32, UInt32

from gsgen.contract.spec import layout
from gsgen.runtime.gpu.compact_rows import PACKED_BYTES, pack_rows
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.spatial_order import ARRANGED_FROM, SpatialOrder
from gsgen.runtime.gpu.upload import Target, upload
from gsgen.runtime.scene.splat_data import SplatData

PAGE_ROWS: Final = 1 << 18
"""Rows of a page: SH of degree 3 in float32 are 48 MiB, of the 128 that every device binds."""

_WORD: Final = 16


def stride(channels: int, *, half: bool) -> int:
    """Return the length of an appearance row on the GPU, in words of 16 bytes.

    Shaders read it by such words, so rows are filled up to whole ones; 0 means that two rows
    share one.
    """
    size = channels * (2 if half else 4)
    return 0 if size <= _WORD // 2 else -(-size // _WORD)


def bytes_of(data: SplatData, *, compact: bool) -> int:
    """Return how many bytes the rows of a set, their appearance and its cells take on the GPU."""
    half = compact or data.appearance.dtype == np.float16
    row = _bytes_of_row(packed=compact and data.cells is None)
    row += _bytes_of_appearance(stride(data.appearance.shape[1], half=half))
    cells = 0 if data.cells is None else 4 * layout.ROW * len(data.cells)
    return len(data) * row + cells


def _bytes_of_row(*, packed: bool) -> int:
    return PACKED_BYTES if packed else 4 * layout.ROW


def _bytes_of_appearance(stride: int) -> int:
    return _WORD * stride or _WORD // 2


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Page:
    """Consecutive rows of one set in GPU buffers.

    Attributes:
        first: Index of the page's first row in the set.
        capacity: Rows of the page.
        rows: Buffer of packed rows.
        appearance: Buffer of their appearance.
        half: Whether the appearance is float16 there.
        stride: Of the appearance, in words of 16 bytes; 0 where two rows share one.
        packed: Whether rows are, as compact_rows.py does.
        cells: Buffer of all cells of the set, where it has some.
        rows_of: Which row of the set each of the page's rows is, where they are arranged.
    """

    first: int
    capacity: int
    rows: Buffer
    appearance: Buffer
    half: bool
    stride: int
    packed: bool = False
    cells: Buffer | None = None
    rows_of: UInt32[np.ndarray, " n"] | None = None


def _rows_of(page: Page, first: int, rows: Float[np.ndarray, "n 10"]) -> Target:
    make = pack_rows if page.packed else None if rows.dtype == np.float32 else _wide
    return Target(page.rows, first, _bytes_of_row(packed=page.packed), make)


def _wide(rows: Float[np.ndarray, "n 10"]) -> Float32[np.ndarray, "n 10"]:
    return rows.astype(np.float32)


def _appearance_of(page: Page, first: int, appearance: Float[np.ndarray, "n c"]) -> Target:
    dtype = np.dtype(np.float16 if page.half else np.float32)
    size = _bytes_of_appearance(page.stride)
    same = appearance.dtype == dtype and size == appearance.strides[0]
    make = None if same else partial(_typed, dtype=dtype, size=size)
    return Target(page.appearance, first, size, make)


def _typed(
    appearance: Float[np.ndarray, "n c"], dtype: np.dtype[Any], size: int
) -> Float[np.ndarray, "n d"]:
    """Return appearance of another type, with zeros up to rows of ``size`` bytes."""
    converted = np.zeros((len(appearance), size // dtype.itemsize), dtype)
    with np.errstate(over="ignore"):  # what float16 cannot hold is infinite, and not drawn
        converted[:, : appearance.shape[1]] = appearance
    return converted


@final
@dataclass(slots=True, eq=False)
class _Filled:
    """The uploaded part of one array.

    Attributes:
        version: Which version of it.
        rows: How many of its first rows.
    """

    version: int = -1
    rows: int = 0

    def missing(self, version: int, live: int) -> Iterator[slice]:
        """Yield the live rows that are not uploaded, if any, and count them as uploaded."""
        first = self.rows if self.version == version else 0
        if live > first:
            yield slice(first, live)
        self.version, self.rows = version, max(first, live)


@final
class _State(NamedTuple):
    """Versions of a set's arrays at the start of a frame, and its count of live rows."""

    rows: int
    appearance: int
    live: int


@final
@dataclass(slots=True, eq=False, kw_only=True)
class _Resident:
    """The pages of one ``SplatData`` on the GPU, and the rows that are uploaded.

    Attributes:
        state: Versions at the start of the last frame.
        order: Spatial order of the rows, if they have one.
        is_unordered: Whether the rows keep their own order for good.
    """

    pages: list[Page]
    rows: _Filled
    appearance: _Filled
    cells: _Filled
    state: _State | None = None
    order: SpatialOrder | None = None
    is_unordered: bool = False


def _parts(pages: list[Page], live: slice) -> Iterator[tuple[Page, slice, int]]:
    """Yield each page with its part of ``live`` and the index of its first such row."""
    for page in pages:
        first = max(live.start, page.first)
        last = min(live.stop, page.first + page.capacity)
        if first < last:
            yield page, slice(first, last), first - page.first


@final
class Residency:
    """Keeps each ``SplatData`` on the GPU for as long as it exists.

    Args:
        device: Where the buffers are.
        page_rows: Rows of a page.
        compact: Keep every appearance in float16, and rows packed, but for sets with cells.
    """

    def __init__(
        self, device: Device, page_rows: int = PAGE_ROWS, *, compact: bool = False
    ) -> None:
        self._compact = compact
        self._device = device
        self._page_rows = page_rows
        self._held: WeakKeyDictionary[SplatData, _Resident]
        self._held = WeakKeyDictionary()

    def begin(self, data: SplatData) -> None:
        """Note that a frame with ``data`` begins; from the second one on rows are arranged.

        Rows that are neighbours in space are then neighbours in memory, which nearly halves what
        a frame of a million costs: splats of a tile are read together. Rows that change keep the
        order of an earlier frame, if they are written straight to where shaders read: there, one
        order costs as much as another. Elsewhere they go back to their own for good, and so do
        those of a set whose count changes.
        """
        resident = self._hold(data)
        now = _State(data.rows_version, data.appearance_version, data.count)
        if resident.state is not None:
            self._follow(data, resident, resident.state, now)
        resident.state = now  # not before: where there is no memory, the next frame has to follow

    def _follow(self, data: SplatData, resident: _Resident, before: _State, now: _State) -> None:
        """Choose the order and the packing of rows after a frame."""
        moved = before.rows != now.rows
        if moved:
            self._unpack(resident)
        if before != now and not (self._device.maps and before.live == now.live):
            if resident.order is not None:
                self.restore_order(data)
        elif resident.is_unordered or len(data) < ARRANGED_FROM or data.cells is not None:
            return
        elif resident.order is None or (moved and not resident.order.is_valid_after_change(data)):
            self._arrange(resident, SpatialOrder.of(data))

    def restore_order(self, data: SplatData) -> None:
        """Restore the rows' own order for good."""
        resident = self._hold(data)
        resident.is_unordered = True
        self._arrange(resident, None)

    def _unpack(self, resident: _Resident) -> None:
        """Store rows unpacked, since they change: packing them takes longer than a frame."""
        if any(page.packed for page in resident.pages):
            size = _bytes_of_row(packed=False)
            resident.rows = _Filled()
            resident.pages = [
                replace(
                    page,
                    packed=False,
                    rows=self._device.dynamic_storage("rows", size * page.capacity),
                )
                for page in resident.pages
            ]

    def _arrange(self, resident: _Resident, order: SpatialOrder | None) -> None:
        """Set another order of the rows; all are uploaded again."""
        resident.order = order
        resident.rows, resident.appearance = _Filled(), _Filled()
        resident.pages = [
            replace(
                page,
                rows_of=None
                if order is None
                else order.rows[page.first : page.first + page.capacity],
            )
            for page in resident.pages
        ]

    def _hold(self, data: SplatData) -> _Resident:
        if data not in self._held:
            self._held[data] = _Resident(
                pages=list(self._allocate(data)),
                rows=_Filled(),
                appearance=_Filled(),
                cells=_Filled(),
            )
        return self._held[data]

    def pages(self, data: SplatData) -> list[Page]:
        """Return the pages of ``data``, with its present values in all live rows of them."""
        resident = self._hold(data)
        for live in resident.rows.missing(data.rows_version, data.count):
            self._upload(resident, live, data.rows, _rows_of)
        for live in resident.appearance.missing(data.appearance_version, data.count):
            self._upload(resident, live, data.appearance, _appearance_of)
        self._write_cells(data, resident)
        return resident.pages

    def _upload(
        self,
        resident: _Resident,
        live: slice,
        array: Float[np.ndarray, "n c"],
        target: Callable[[Page, int, np.ndarray], Target],
    ) -> None:
        """Write live rows of an array into what pages have for it."""
        for page, part, first in _parts(resident.pages, live):
            to = target(page, first, array)
            if resident.order is None:
                upload(self._device, to, array[part])
            else:
                upload(self._device, to, array, resident.order.rows[part])

    def _write_cells(self, data: SplatData, resident: _Resident) -> None:
        if data.cells is None or not resident.pages:
            return
        for part in resident.cells.missing(data.cells_version, len(data.cells)):
            make = None if data.cells.dtype == np.float32 else _wide
            to = Target(resident.pages[0].cells, part.start, _bytes_of_row(packed=False), make)
            upload(self._device, to, data.cells[part])

    def _allocate(self, data: SplatData) -> Iterator[Page]:
        half = self._compact or data.appearance.dtype == np.float16
        words = stride(data.appearance.shape[1], half=half)
        packed = self._compact and data.cells is None
        cells = None
        if data.cells is not None:
            cells = self._device.dynamic_storage("cells", 4 * layout.ROW * len(data.cells))
        for first in range(0, len(data), self._page_rows):
            capacity = min(self._page_rows, len(data) - first)
            yield Page(
                first=first,
                capacity=capacity,
                rows=self._device.dynamic_storage("rows", capacity * _bytes_of_row(packed=packed)),
                appearance=self._device.dynamic_storage(
                    "appearance", capacity * _bytes_of_appearance(words)
                ),
                half=half,
                stride=words,
                packed=packed,
                cells=cells,
            )
