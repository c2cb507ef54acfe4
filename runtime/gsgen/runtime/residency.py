"""What is on the GPU: the rows of every set, in pages that no binding outgrows."""

__all__ = ["PAGE_ROWS", "Page", "Residency", "stride"]

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, final
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float

from gsgen.contract import layout
from gsgen.runtime.device import Device
from gsgen.runtime.splat_data import SplatData

PAGE_ROWS: Final = 1 << 18
"""Rows of a page: SH of degree 3 in float32 are 48 MiB, of the 128 that every device binds."""


_WORD: Final = 16


def stride(channels: int, half: bool) -> int:
    """Return how long a row of the appearance is on the GPU, in words of 16 bytes.

    Shaders read it by such words, so rows are filled up to whole ones.
    """
    return -(-channels * (2 if half else 4) // _WORD)


def _padded(appearance: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "n d"]:
    """Return the rows with zeros up to a whole word."""
    step = _WORD // appearance.itemsize
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
        stride: Of the appearance, in words of 16 bytes.
        cells: Buffer of all cells of the set, where it has some.
    """

    first: int
    capacity: int
    rows: Any
    appearance: Any
    half: bool
    stride: int
    cells: Any = None


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
@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """What is on the GPU of one ``SplatData``: its pages, and how far each array fills them."""

    pages: list[Page]
    rows: _Filled
    appearance: _Filled
    cells: _Filled


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
        compact: Keep every appearance in float16.
    """

    def __init__(
        self, device: Device, page_rows: int = PAGE_ROWS, *, compact: bool = False
    ) -> None:
        self._compact = compact
        self._device = device
        self._page_rows = page_rows
        self._held: WeakKeyDictionary[SplatData, _Held]
        self._held = WeakKeyDictionary()

    def pages(self, data: SplatData) -> list[Page]:
        """Return the pages of ``data``, with its present values in all live rows of them."""
        if data not in self._held:
            filled = (_Filled(), _Filled(), _Filled())
            self._held[data] = _Held(list(self._allocate(data)), *filled)
        held = self._held[data]
        for live in held.rows.missing(data.rows_version, data.count):
            for page, part, offset in _parts(held.pages, live):
                rows = data.rows[part].astype(np.float32, copy=False)
                self._device.write(page.rows, rows, offset * 4 * layout.ROW)
        for live in held.appearance.missing(data.appearance_version, data.count):
            for page, part, offset in _parts(held.pages, live):
                typed = self._appearance(data, page, part)
                self._device.write(page.appearance, typed, offset * _WORD * page.stride)
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
        self, data: SplatData, page: Page, part: slice
    ) -> Float[np.ndarray, "n d"]:
        """Return a part of the appearance as ``page`` has it."""
        with np.errstate(
            over="ignore"
        ):  # what float16 cannot hold is infinite, and not drawn
            typed = data.appearance[part].astype(
                np.float16 if page.half else np.float32, copy=False
            )
        return _padded(typed)

    def _allocate(self, data: SplatData) -> Iterator[Page]:
        half = self._is_half(data)
        words = stride(data.appearance.shape[1], half)
        cells = None
        if data.cells is not None:
            cells = self._device.storage("cells", 4 * layout.ROW * len(data.cells))
        for first in range(0, len(data), self._page_rows):
            capacity = min(self._page_rows, len(data) - first)
            yield Page(
                first,
                capacity,
                self._device.storage("rows", capacity * 4 * layout.ROW),
                self._device.storage("appearance", capacity * _WORD * words),
                half,
                words,
                cells,
            )
