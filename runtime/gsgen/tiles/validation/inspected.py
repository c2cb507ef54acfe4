"""The input of the tileset rules: a tileset, its faults, and its contents, each read once."""

__all__ = ["InspectedContent", "InspectedTileset", "inspect_content_file", "inspect_tileset"]

import hashlib
import time
import warnings
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, final

import numpy as np

from gsgen.formats.glb.container import Container
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splats import Splats
from gsgen.tiles.build_record import BuildRecord, read_build_record
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.gltf.container import open_content
from gsgen.tiles.gltf.decoding import ContentHeader, decode_content, read_header
from gsgen.tiles.gltf.placement import place
from gsgen.tiles.leaves import MAX_CONTENT
from gsgen.tiles.loading import load_tileset
from gsgen.tiles.stores.store import Store
from gsgen.tiles.tileset import Content, Tile, Tileset
from gsgen.tiles.uris import resolve_uri
from gsgen.tiles.validation.values import ContentValues, check_values, measure_content
from gsgen.tiles.volumes import Volume

if TYPE_CHECKING:
    from gsgen.tiles.validation.drawing import DrawnTileset

Progress = Callable[[str], None]
_MOST_FAULTS: Final = 1000


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InspectedContent:
    """A content file of a tile, with its header, digest and measured values.

    Attributes:
        tile: The tile; None for a file that was given alone.
        content: What the tile says of it.
        header: What the file says of its splats; None where it cannot be read.
        sha256: Of the file, where a build record lists it.
        values: Measurements of the decoded splats; None where nothing was decoded.
    """

    tile: Tile | None
    content: Content
    header: ContentHeader | None
    sha256: str = ""
    values: ContentValues | None = None


@final
@dataclass(slots=True, kw_only=True, eq=False)
class InspectedTileset:
    """A tileset with its contents, faults and build record, as input of the rules GT.

    Attributes:
        tileset: The tree; None where the index cannot be read, or a content was given alone.
        store: Where its files lie.
        faults: Those that reading met, by kind.
        contents: All contents, in the order of the tiles.
        record: What ``gsgen.tiles.json`` says; None without one.
        undecoded: Why some contents were not decoded; empty where all were.
        drawn: The results of drawing tiles; None where nothing was drawn.
        undrawn: Why tiles were not drawn; empty where they were, or were not to be.
        files: How many files were read.
    """

    tileset: Tileset | None
    store: Store
    faults: dict[Fault, list[TilesetInvalid]] = field(default_factory=lambda: defaultdict(list))
    contents: list[InspectedContent] = field(default_factory=list)
    record: BuildRecord | None = None
    undecoded: str = ""
    drawn: "DrawnTileset | None" = None
    undrawn: str = ""
    files: int = 0

    @property
    def is_ours(self) -> bool:
        """Whether the tileset declares the gsgen profile, which requires more than 3D Tiles."""
        return self.tileset is not None and "source_splats" in self.tileset.metadata

    def note(self, error: TilesetInvalid) -> None:
        """Record a fault of the tileset for the validation rules to report."""
        if sum(map(len, self.faults.values())) < _MOST_FAULTS:
            self.faults[error.fault].append(error)

    drop = note


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
    try:
        inspected.tileset = load_tileset(store, index, report=inspected, name=name)
    except TilesetInvalid as error:
        if error.fault is Fault.CONTENT or "is not JSON" in error.actual:
            raise
        inspected.note(error)
        return inspected
    try:
        inspected.record = read_build_record(store, index)
    except TilesetInvalid as error:
        inspected.note(error)
    reader = _ContentReader(inspected, decode=decode, deadline=time.monotonic() + seconds)
    tiles = [tile for tile in inspected.tileset.tiles() if tile.contents]
    for number, tile in enumerate(tiles):
        if number % 64 == 0:
            progress(f"reading tile {number + 1} of {len(tiles)}")
        inspected.contents += [reader.read(tile, content) for content in tile.contents]
    return inspected


def inspect_content_file(
    store: Store, path: str, *, decode: bool, seconds: float
) -> InspectedTileset:
    """Read one content file as input of the tileset rules."""
    inspected = InspectedTileset(tileset=None, store=store)
    reader = _ContentReader(inspected, decode=decode, deadline=time.monotonic() + seconds)
    content = Content(uri=path, volume=None, location=path)
    inspected.contents.append(reader.read(None, content))
    return inspected


@final
class _ContentReader:
    """Reads content files of tiles; a file that several tiles share is checked once."""

    def __init__(self, inspected: InspectedTileset, *, decode: bool, deadline: float) -> None:
        self._inspected, self._decode = inspected, decode
        self._deadline = deadline
        self._headers: dict[str, tuple[ContentHeader | None, str]] = {}

    def read(self, tile: Tile | None, content: Content) -> InspectedContent:
        """Read a tile's content; record its faults in the inspected tileset."""
        known = content.uri in self._headers
        late = self._decode and time.monotonic() > self._deadline
        if late:
            self._inspected.undecoded = "the time was up before all contents were decoded"
        if known and (late or not self._decode):
            header, digest = self._headers[content.uri]
            return InspectedContent(tile=tile, content=content, header=header, sha256=digest)
        header, digest, values = None, "", None
        try:
            data = self._inspected.store.read(content.uri, limit=MAX_CONTENT)
            self._inspected.files += not known
            record = self._inspected.record
            if record is not None and content.uri in record.files:
                digest = hashlib.sha256(data).hexdigest()
            container = open_content(data, content.uri, self._fetch(content.uri))
            header = read_header(container, content.uri, len(data))
            if self._decode and not late:
                values = self._values(tile, content, container)
        except TilesetInvalid as error:
            if not known:
                self._inspected.note(error)
        self._headers[content.uri] = header, digest
        return InspectedContent(
            tile=tile, content=content, header=header, sha256=digest, values=values
        )

    def _fetch(self, base: str) -> Callable[[str, str, int], bytes]:
        def fetch(uri: str, location: str, size: int) -> bytes:
            path = resolve_uri(base, uri, location)
            return self._inspected.store.read(path, size=size, limit=MAX_CONTENT)

        return fetch

    def _values(self, tile: Tile | None, content: Content, container: Container) -> ContentValues:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FormatWarning)  # GT019 says so
            decoded = decode_content(container, content.uri)
        splats: list[Splats] = [entry for entry, _ in decoded]
        check_values(container, splats, content.uri)
        tileset = self._inspected.tileset
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
