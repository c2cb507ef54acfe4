"""What is on the GPU: the rows of every set, in pages that no binding outgrows."""

__all__ = ["PAGE_ROWS", "Page", "Residency", "bytes_of", "stride"]

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final, final
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, UInt32

from gsgen.contract import layout
from gsgen.runtime.curve import along_curve
from gsgen.runtime.device import Device
from gsgen.runtime.packing import PACKED_BYTES, pack_rows
from gsgen.runtime.splat_data import SplatData

PAGE_ROWS: Final = 1 << 18
"""Rows of a page: SH of degree 3 in float32 are 48 MiB, of the 128 that every device binds."""

ARRANGED_FROM: Final = 1 << 15
"""Rows from which on their order in memory counts: fewer are in a cache anyway."""

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
    row = PACKED_BYTES if compact and data.cells is None else 4 * layout.ROW
    row += _row_bytes(stride(data.appearance.shape[1], half))
    cells = 0 if data.cells is None else 4 * layout.ROW * len(data.cells)
    return len(data) * row + cells


def _row_bytes(stride: int) -> int:
    return _WORD * stride or _WORD // 2


def _padded(appearance: Float[np.ndarray, "n c"], size: int) -> Float[np.ndarray, "n d"]:
    """Return the rows with zeros up to a multiple of ``size`` bytes."""
    step = size // appearance.itemsize
    missing = -appearance.shape[1] % step
    return np.pad(appearance, ((0, 0), (0, missing))) if missing else appearance


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
@dataclass(slots=True, eq=False)
class _Held:
    """What is on the GPU of one ``SplatData``: its pages, and how far each array fills them.

    Attributes:
        state: What the values were when the last frame began.
        order: Which row is where, if they are arranged.
        arranged: Whether they have been; what then changes is not arranged again.
    """

    pages: list[Page]
    rows: _Filled
    appearance: _Filled
    cells: _Filled
    state: tuple[int, ...] | None = None
    order: UInt32[np.ndarray, " n"] | None = None
    arranged: bool = False


def _parts(pages: list[Page], live: slice) -> Iterator[tuple[Page, slice, int]]:
    """Yield which rows of ``live`` each page has, and from which of its own rows on."""
    for page in pages:
        first = max(live.start, page.first)
        last = min(live.stop, page.first + page.capacity)
        if first < last:
            yield page, slice(first, last), first - page.first


def _rows(held: _Held, part: slice) -> slice | UInt32[np.ndarray, " m"]:
    """Return which rows of the set are in a part of the pages."""
    return part if held.order is None else held.order[part]


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
        """Note that a frame with ``data`` begins: what stays as it is becomes arranged.

        Rows that are neighbours in space are then neighbours in memory, which halves what a
        frame of a million costs: splats of a tile are read together. That takes as long as
        some frames, so it is not done for the first one, nor again once values have changed.
        """
        held = self._hold(data)
        state = (data.rows_version, data.appearance_version, data.count)
        if held.state != state:
            if held.order is not None:
                self._arrange(held, None)
        elif not held.arranged and len(data) >= ARRANGED_FROM and data.cells is None:
            live = along_curve(data.rows[: data.count, layout.POSITION])
            rest = np.arange(data.count, len(data))
            self._arrange(held, np.concatenate([live, rest]).astype(np.uint32))
        held.state = state

    def leave(self, data: SplatData) -> None:
        """Have the rows in their own order, now and from now on."""
        self._arrange(self._hold(data), None)

    def _arrange(self, held: _Held, order: UInt32[np.ndarray, " n"] | None) -> None:
        """Have the rows in another order; they are to be written again."""
        held.order, held.arranged = order, True
        held.rows, held.appearance = _Filled(), _Filled()
        held.pages = [
            replace(
                page,
                rows_of=None
                if order is None
                else order[page.first : page.first + page.capacity],
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
            for page, part, offset in _parts(held.pages, live):
                rows = data.rows[_rows(held, part)]
                if page.packed:
                    self._device.write(page.rows, pack_rows(rows), offset * PACKED_BYTES)
                else:
                    typed = rows.astype(np.float32, copy=False)
                    self._device.write(page.rows, typed, offset * 4 * layout.ROW)
        for live in held.appearance.missing(data.appearance_version, data.count):
            for page, part, offset in _parts(held.pages, live):
                typed = self._appearance(data, page, _rows(held, part))
                start = offset * _row_bytes(page.stride)
                self._device.write(page.appearance, typed, start)
        self._write_cells(data, held)
        return held.pages

    def _write_cells(self, data: SplatData, held: _Held) -> None:
        if data.cells is None or not held.pages:
            return
        for part in held.cells.missing(data.cells_version, len(data.cells)):
            rows = data.cells[part].astype(np.float32, copy=False)
            self._device.write(held.pages[0].cells, rows, part.start * 4 * layout.ROW)

    def _is_half(self, data: SplatData) -> bool:
        return self._compact or data.appearance.dtype == np.float16

    def _appearance(
        self, data: SplatData, page: Page, part: slice | UInt32[np.ndarray, " m"]
    ) -> Float[np.ndarray, "n d"]:
        """Return a part of the appearance as ``page`` has it."""
        with np.errstate(
            over="ignore"
        ):  # what float16 cannot hold is infinite, and not drawn
            typed = data.appearance[part].astype(
                np.float16 if page.half else np.float32, copy=False
            )
        return _padded(typed, _row_bytes(page.stride))

    def _allocate(self, data: SplatData) -> Iterator[Page]:
        half = self._is_half(data)
        words = stride(data.appearance.shape[1], half)
        packed = self._compact and data.cells is None
        row = PACKED_BYTES if packed else 4 * layout.ROW
        cells = None
        if data.cells is not None:
            cells = self._device.storage("cells", 4 * layout.ROW * len(data.cells))
        for first in range(0, len(data), self._page_rows):
            capacity = min(self._page_rows, len(data) - first)
            yield Page(
                first,
                capacity,
                self._device.storage("rows", capacity * row),
                self._device.storage("appearance", capacity * _row_bytes(words)),
                half,
                words,
                packed,
                cells,
            )
