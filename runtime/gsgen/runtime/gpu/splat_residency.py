"""What is on the GPU: the rows of every set, in pages that no binding outgrows."""

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
from gsgen.runtime.gpu.spatial_order import ARRANGED_FROM, SpatialOrder
from gsgen.runtime.gpu.upload import Target, upload
from gsgen.runtime.scene.splat_data import SplatData

PAGE_ROWS: Final = 1 << 18
"""Rows of a page: SH of degree 3 in float32 are 48 MiB, of the 128 that every device binds."""

_WORD: Final = 16


def stride(channels: int, half: bool) -> int:
    """Return how long a row of the appearance is on the GPU, in words of 16 bytes.

    Shaders read it by such words, so rows are filled up to whole ones; 0 means that two rows
    share one.
    """
    size = channels * (2 if half else 4)
    return 0 if size <= _WORD // 2 else -(-size // _WORD)


def bytes_of(data: SplatData, *, compact: bool) -> int:
    """Return how many bytes the rows of a set, their appearance and its cells take on the GPU."""
    half = compact or data.appearance.dtype == np.float16
    row = _bytes_of_row(compact and data.cells is None)
    row += _bytes_of_appearance(stride(data.appearance.shape[1], half))
    cells = 0 if data.cells is None else 4 * layout.ROW * len(data.cells)
    return len(data) * row + cells


def _bytes_of_row(packed: bool) -> int:
    return PACKED_BYTES if packed else 4 * layout.ROW


def _bytes_of_appearance(stride: int) -> int:
    return _WORD * stride or _WORD // 2


@final
@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """Some rows of one set, on the GPU.

    Attributes:
        first: Index of the page's first row in the set.
        capacity: Rows of the page.
        rows: Buffer of packed rows.
        appearance: Buffer of their appearance.
        half: Whether the appearance is float16 there.
        stride: Of the appearance, in words of 16 bytes; 0 where two rows share one.
        packed: Whether rows are, as packing.py says.
        cells: Buffer of all cells of the set, where it has some.
        rows_of: Which row of the set each of the page's rows is, where they are arranged.
    """

    first: int
    capacity: int
    rows: Any
    appearance: Any
    half: bool
    stride: int
    packed: bool = False
    cells: Any = None
    rows_of: UInt32[np.ndarray, " n"] | None = None


def _rows_of(page: Page, first: int, rows: Float[np.ndarray, "n 10"]) -> Target:
    make = pack_rows if page.packed else None if rows.dtype == np.float32 else _wide
    return Target(page.rows, first, _bytes_of_row(page.packed), make)


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
    made = np.zeros((len(appearance), size // dtype.itemsize), dtype)
    with np.errstate(over="ignore"):  # what float16 cannot hold is infinite, and not drawn
        made[:, : appearance.shape[1]] = appearance
    return made


@final
@dataclass(slots=True, eq=False)
class _Filled:
    """How much of one array is on the GPU.

    Attributes:
        version: Which version of it.
        rows: How many of its first rows.
    """

    version: int = -1
    rows: int = 0

    def missing(self, version: int, live: int) -> Iterator[slice]:
        """Yield the live rows that are not there, if any, and count them as there."""
        first = self.rows if self.version == version else 0
        if live > first:
            yield slice(first, live)
        self.version, self.rows = version, max(first, live)


@final
class _State(NamedTuple):
    """What the values of a set were when a frame began: their versions, and how many are live."""

    rows: int
    appearance: int
    live: int


@final
@dataclass(slots=True, eq=False)
class _Held:
    """What is on the GPU of one ``SplatData``: its pages, and how far each array fills them.

    Attributes:
        state: What the values were when the last frame began.
        order: Which row is where, if they are arranged.
        left: Whether they stay in their own order.
    """

    pages: list[Page]
    rows: _Filled
    appearance: _Filled
    cells: _Filled
    state: _State | None = None
    order: SpatialOrder | None = None
    left: bool = False


def _parts(pages: list[Page], live: slice) -> Iterator[tuple[Page, slice, int]]:
    """Yield which rows of ``live`` each page has, and from which of its own rows on."""
    for page in pages:
        first = max(live.start, page.first)
        last = min(live.stop, page.first + page.capacity)
        if first < last:
            yield page, slice(first, last), first - page.first


@final
class Residency:
    """Keeps each ``SplatData`` on the GPU for as long as anybody holds it.

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
        self._held: WeakKeyDictionary[SplatData, _Held]
        self._held = WeakKeyDictionary()

    def begin(self, data: SplatData) -> None:
        """Note that a frame with ``data`` begins; from the second one on rows are arranged.

        Rows that are neighbours in space are then neighbours in memory, which nearly halves what
        a frame of a million costs: splats of a tile are read together. Rows that change keep the
        order of an earlier frame, if they are written straight to where shaders read: there, one
        order costs as much as another. Elsewhere they go back to their own for good, and so do
        those of a set whose count changes.
        """
        held = self._hold(data)
        now = _State(data.rows_version, data.appearance_version, data.count)
        if held.state is not None:
            self._follow(data, held, held.state, now)
        held.state = (
            now  # not before: where there is no memory, the next frame has to follow
        )

    def _follow(self, data: SplatData, held: _Held, before: _State, now: _State) -> None:
        """Have the rows as they should be after another frame."""
        moved = before.rows != now.rows
        if moved:
            self._unpack(held)
        if before != now and not (self._device.maps and before.live == now.live):
            if held.order is not None:
                self.leave(data)
        elif held.left or len(data) < ARRANGED_FROM or data.cells is not None:
            return
        elif held.order is None or (moved and not held.order.lasts(data)):
            self._arrange(held, SpatialOrder.found(data))

    def leave(self, data: SplatData) -> None:
        """Have the rows in their own order, now and from now on."""
        held = self._hold(data)
        held.left = True
        self._arrange(held, None)

    def _unpack(self, held: _Held) -> None:
        """Have rows as they are, since they change: packing them takes longer than a frame."""
        if any(page.packed for page in held.pages):
            size = _bytes_of_row(False)
            held.rows = _Filled()
            held.pages = [
                replace(
                    page,
                    packed=False,
                    rows=self._device.filled("rows", size * page.capacity),
                )
                for page in held.pages
            ]

    def _arrange(self, held: _Held, order: SpatialOrder | None) -> None:
        """Have the rows in another order; they are to be written again."""
        held.order = order
        held.rows, held.appearance = _Filled(), _Filled()
        held.pages = [
            replace(
                page,
                rows_of=None
                if order is None
                else order.rows[page.first : page.first + page.capacity],
            )
            for page in held.pages
        ]

    def _hold(self, data: SplatData) -> _Held:
        if data not in self._held:
            filled = (_Filled(), _Filled(), _Filled())
            self._held[data] = _Held(list(self._allocate(data)), *filled)
        return self._held[data]

    def pages(self, data: SplatData) -> list[Page]:
        """Return the pages of ``data``, with its present values in all live rows of them."""
        held = self._hold(data)
        for live in held.rows.missing(data.rows_version, data.count):
            self._upload(held, live, data.rows, _rows_of)
        for live in held.appearance.missing(data.appearance_version, data.count):
            self._upload(held, live, data.appearance, _appearance_of)
        self._write_cells(data, held)
        return held.pages

    def _upload(
        self,
        held: _Held,
        live: slice,
        array: Float[np.ndarray, "n c"],
        target: Callable[[Page, int, np.ndarray], Target],
    ) -> None:
        """Write live rows of an array into what pages have for it."""
        for page, part, first in _parts(held.pages, live):
            to = target(page, first, array)
            if held.order is None:
                upload(self._device, to, array[part])
            else:
                upload(self._device, to, array, held.order.rows[part])

    def _write_cells(self, data: SplatData, held: _Held) -> None:
        if data.cells is None or not held.pages:
            return
        for part in held.cells.missing(data.cells_version, len(data.cells)):
            make = None if data.cells.dtype == np.float32 else _wide
            to = Target(held.pages[0].cells, part.start, _bytes_of_row(False), make)
            upload(self._device, to, data.cells[part])

    def _allocate(self, data: SplatData) -> Iterator[Page]:
        half = self._compact or data.appearance.dtype == np.float16
        words = stride(data.appearance.shape[1], half)
        packed = self._compact and data.cells is None
        cells = None
        if data.cells is not None:
            cells = self._device.filled("cells", 4 * layout.ROW * len(data.cells))
        for first in range(0, len(data), self._page_rows):
            capacity = min(self._page_rows, len(data) - first)
            yield Page(
                first,
                capacity,
                self._device.filled("rows", capacity * _bytes_of_row(packed)),
                self._device.filled("appearance", capacity * _bytes_of_appearance(words)),
                half,
                words,
                packed,
                cells,
            )
