"""Reads and decodes the contents of a tileset on threads, as input of the tileset rules.

Reading a file waits for the disk or the network, and decoding it mostly runs outside of Python's
lock. Results are taken in the order of the tiles, so that reports do not depend on threads.
"""

__all__ = ["inspect_content_file", "inspect_tileset"]

import hashlib
import os
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import Final, final

import numpy as np

from gsgen.formats.glb.container import Container
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splats import Splats
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.tileset import Content, Tile
from gsgen.tiles.format.volumes import Volume
from gsgen.tiles.gltf.container import MAX_CONTENT_BYTES
from gsgen.tiles.gltf.decoding import ContentHeader, decode_content, read_header
from gsgen.tiles.gltf.placement import place
from gsgen.tiles.loading.build_record import read_build_record
from gsgen.tiles.loading.leaves import open_tile_content
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.stores.store import Store
from gsgen.tiles.validation.inspected import InspectedContent, InspectedTileset
from gsgen.tiles.validation.values import ContentValues, check_values, measure_content

Progress = Callable[[str], None]
_MAX_THREADS: Final = 4


def inspect_tileset(
    store: Store, index: str, *, decode: bool, seconds: float, progress: Progress, name: str
) -> InspectedTileset:
    """Read a tileset and its contents as input of the tileset rules.

    Args:
        store: Where its files lie.
        index: Path of ``tileset.json``.
        decode: Whether splats are decoded, too.
        seconds: After how long no further content is decoded.
        progress: Called with a few words whenever a new stage begins.
        name: Name of the tileset in messages.
    """
    inspected = InspectedTileset(tileset=None, store=store)
    deadline = time.monotonic() + seconds
    try:
        inspected.tileset = load_tileset(store, index, report=inspected, name=name)
    except TilesetInvalid as error:
        if error.fault is Fault.CONTENT or "is not JSON" in error.actual:
            raise
        inspected.note(error)
        return inspected
    finally:
        inspected.note_document_faults()
    try:
        inspected.record = read_build_record(store, index)
    except TilesetInvalid as error:
        inspected.note(error)
    tiles = inspected.tileset.tiles()
    pairs = [(tile, content) for tile in tiles for content in tile.contents]
    _read_contents(inspected, pairs, decode=decode, deadline=deadline, progress=progress)
    return inspected


def inspect_content_file(
    store: Store, path: str, *, decode: bool, seconds: float
) -> InspectedTileset:
    """Read one content file as input of the tileset rules."""
    inspected = InspectedTileset(tileset=None, store=store)
    pairs = [(None, Content(uri=path, volume=None, location=path))]
    deadline = time.monotonic() + seconds
    _read_contents(inspected, pairs, decode=decode, deadline=deadline, progress=lambda words: None)
    return inspected


@final
@dataclass(slots=True, kw_only=True)
class _FileResult:
    """The result of reading a tile's content file, which several tiles may name.

    Attributes:
        header: None where the file cannot be read.
        sha256: Where a build record lists the file.
        values: None where nothing was decoded.
        error: What is wrong with the file.
        is_late: Whether it was not decoded since the time was up.
    """

    header: ContentHeader | None = None
    sha256: str = ""
    values: ContentValues | None = None
    error: TilesetInvalid | None = None
    is_late: bool = False


def _read_contents(
    inspected: InspectedTileset,
    pairs: Sequence[tuple[Tile | None, Content]],
    *,
    decode: bool,
    deadline: float,
    progress: Progress,
) -> None:
    """Read the contents of tiles on threads, and record contents and faults in order.

    A file that several tiles share is decoded for each, and its faults are recorded once.
    """
    reader = _ContentReader(inspected, decode=decode, deadline=deadline)
    files: dict[str, _FileResult] = {}
    late_files: list[str] = []
    with warnings.catch_warnings(), ThreadPoolExecutor(_threads()) as executor:
        warnings.simplefilter("ignore", FormatWarning)  # GT019 says so
        results = _read_in_order(executor, reader.read, pairs if decode else _distinct_files(pairs))
        for number, (tile, content) in enumerate(pairs):
            if number % 64 == 0:
                progress(f"reading tile {number + 1} of {len(pairs)}")
            known = files.get(content.uri)
            result = next(results) if decode or known is None else known
            if known is None and result.error is not None:
                inspected.note(result.error)
            files[content.uri] = result
            late_files += [content.uri] if result.is_late else []
            inspected.contents.append(
                InspectedContent(
                    tile=tile,
                    content=content,
                    header=result.header,
                    sha256=result.sha256,
                    values=result.values,
                )
            )
    if late_files:
        inspected.undecoded_reason = (
            f"{len(late_files):,} of {len(pairs):,} contents were not decoded when the time was up, "
            f"the first is {late_files[0]}"
        )


def _threads() -> int:
    return min(_MAX_THREADS, os.cpu_count() or 1)


def _distinct_files(
    pairs: Iterable[tuple[Tile | None, Content]],
) -> list[tuple[Tile | None, Content]]:
    content_by_uri: dict[str, tuple[Tile | None, Content]] = {}
    for tile, content in pairs:
        content_by_uri.setdefault(content.uri, (tile, content))
    return list(content_by_uri.values())


def _read_in_order(
    executor: ThreadPoolExecutor,
    read: Callable[[Tile | None, Content], _FileResult],
    pairs: Iterable[tuple[Tile | None, Content]],
) -> Iterator[_FileResult]:
    """Yield the results of reading tile contents in order, with few of them in memory."""
    remaining = iter(pairs)
    pending: deque[Future[_FileResult]] = deque()
    while True:
        for pair in islice(remaining, 2 * _MAX_THREADS - len(pending)):
            pending.append(executor.submit(read, *pair))
        if not pending:
            return
        yield pending.popleft().result()


@final
class _ContentReader:
    """Reads, decodes and measures content files of tiles; safe to use from many threads."""

    def __init__(self, inspected: InspectedTileset, *, decode: bool, deadline: float) -> None:
        self._inspected_tileset, self._decode_content, self._deadline = inspected, decode, deadline

    def read(self, tile: Tile | None, content: Content) -> _FileResult:
        """Read a tile's content; splats are decoded unless the time limit has passed."""
        result = _FileResult(is_late=self._decode_content and time.monotonic() > self._deadline)
        record = self._inspected_tileset.record
        try:
            store = self._inspected_tileset.store.for_one_tile()
            data = store.read(content.uri, limit=MAX_CONTENT_BYTES)
            if record is not None and content.uri in record.files:
                result.sha256 = hashlib.sha256(data).hexdigest()
            container = open_tile_content(store, content, data)
            result.header = read_header(container, content.uri, len(data))
            if container.length not in (0, len(data)):
                raise TilesetInvalid(
                    f"the file has {len(data)} bytes",
                    location=f"{content.uri}, byte 8",
                    expected=f"{container.length}, as the header of the GLB says",
                    fault=Fault.CONTENT,
                )
            if self._decode_content and not result.is_late:
                result.values = self._values(tile, content, container)
        except TilesetInvalid as error:
            result.error = error
        return result

    def _values(self, tile: Tile | None, content: Content, container: Container) -> ContentValues:
        decoded = decode_content(container, content.uri)
        splats: list[Splats] = [entry for entry, _ in decoded]
        check_values(container, splats, content.uri)
        tileset = self._inspected_tileset.tileset
        if tile is None or tileset is None:
            return ContentValues()
        axes = tileset.content_axes
        to_world = tileset.transform
        parts = [
            place(entry, tile.transform @ axes @ matrix) for entry, matrix in decoded if len(entry)
        ]
        tile_to_world = to_world @ tile.transform
        children: list[Volume] = []
        if tile.refine == "REPLACE":
            children = [
                child.volume.transformed(to_world @ child.transform) for child in tile.children
            ]
        scale = float(np.cbrt(np.linalg.det(tile_to_world[:3, :3])))
        return measure_content(
            parts,
            (content.volume or tile.volume).transformed(tile_to_world),
            children,
            tile.geometric_error * scale,
            to_world,
        )
