"""The input of the tileset rules: a tileset, its faults, and its contents, each read once."""

__all__ = ["InspectedContent", "InspectedTileset"]

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, Final, final

from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.json_values import JsonObject
from gsgen.tiles.format.tileset import Content, Tile, Tileset
from gsgen.tiles.gltf.decoding import ContentHeader
from gsgen.tiles.loading.build_record import BuildRecord
from gsgen.tiles.stores.store import Store
from gsgen.tiles.validation.documents import check_document, check_subtree
from gsgen.tiles.validation.values import ContentValues

if TYPE_CHECKING:
    from gsgen.tiles.validation.drawing import DrawnTileset

_MAX_FAULTS: Final = 1000


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
        undecoded_reason: Why some contents were not decoded; empty where all were.
        drawn: The results of drawing tiles; None where nothing was drawn.
        undrawn_reason: Why tiles were not drawn; empty where they were, or were not to be.
    """

    tileset: Tileset | None
    store: Store
    faults: dict[Fault, list[TilesetInvalid]] = field(default_factory=lambda: defaultdict(list))
    contents: list[InspectedContent] = field(default_factory=list)
    record: BuildRecord | None = None
    undecoded_reason: str = ""
    drawn: "DrawnTileset | None" = None
    undrawn_reason: str = ""
    _document_faults: list[TilesetInvalid] = field(default_factory=list)

    @property
    def is_built_by_gsgen(self) -> bool:
        """Whether the tileset's metadata says that gsgen built it: then more rules apply to it."""
        return self.tileset is not None and "source_splats" in self.tileset.metadata

    def note(self, error: TilesetInvalid) -> None:
        """Record a fault of the tileset for the validation rules to report."""
        if sum(map(len, self.faults.values())) < _MAX_FAULTS:
            self.faults[error.fault].append(error)

    drop = note

    def inspect(self, document: JsonObject, schema: JsonObject | None) -> None:
        """Check a ``tileset.json`` that is being read; `note_document_faults` adds the faults."""
        self._document_faults += islice(check_document(document, schema), _MAX_FAULTS)

    def inspect_subtree(self, document: JsonObject) -> None:
        """Check the JSON of a subtree likewise."""
        self._document_faults += islice(check_subtree(document), _MAX_FAULTS)

    def note_document_faults(self) -> None:
        """Record the faults of JSON documents at locations where reading met no fault itself."""
        known = {error.location for errors in self.faults.values() for error in errors}
        for error in self._document_faults:
            if error.location not in known:
                self.note(error)
