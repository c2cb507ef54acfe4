"""Reads a tileset's JSON documents: ``tileset.json`` files and metadata schemas."""

__all__ = ["Document", "DocumentReader"]

from dataclasses import dataclass
from typing import Final, final

from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.format.extensions import CONTENT_EXTENSION
from gsgen.tiles.format.implicit_tiling.property_table import PropertyClass, read_classes
from gsgen.tiles.format.json_values import MAX_JSON, JsonDict, JsonObject, parse_object, shorten
from gsgen.tiles.format.neural_tile import NEURAL_TILE_EXTENSION as NEURAL
from gsgen.tiles.format.uris import is_external, resolve_uri
from gsgen.tiles.loading.limits import Limits, LoadingTime, LoadReport
from gsgen.tiles.stores.store import Store

_SUPPORTED_EXTENSIONS: Final = {CONTENT_EXTENSION, "3DTILES_metadata", NEURAL}
_SUPPORTED_VERSIONS: Final = ("1.0", "1.1")


@final
@dataclass(frozen=True, slots=True)
class Document:
    """A ``tileset.json`` that is being read, with metadata classes and the files that refer to it.

    Attributes:
        path: Of the file, relative to the tileset's folder.
        classes: Of its metadata schema.
        parent_paths: The indices that refer to it, the outermost first.
    """

    path: str
    classes: dict[str, PropertyClass]
    parent_paths: tuple[str, ...]


@final
class DocumentReader:
    """Reads the ``tileset.json`` files of one tileset, within limits of number and size."""

    def __init__(self, store: Store, limits: Limits, report: LoadReport) -> None:
        self._store, self._limits, self._report = store, limits, report
        self._bytes_left = limits.index_bytes
        self._documents = self._listed_count = 0
        self._time = LoadingTime(store.name)

    def add_bytes(self, size: int, path: str) -> None:
        """Add a JSON document's bytes to the total; raise above the limits of reading a tileset."""
        self._bytes_left -= size
        self._documents += 1
        self._require_document_limit(self._documents, path)
        self._time.require(f"{self._documents:,} JSON and subtree files")
        if self._bytes_left < 0:
            raise TilesetInvalid(
                f"JSON and subtree files have more than {self._limits.index_bytes:,} bytes",
                location=f"{self._store.name}: {path}",
                expected="fewer",
            )

    def _require_document_limit(self, documents: int, path: str) -> None:
        if documents > self._limits.documents:
            raise TilesetInvalid(
                f"the tileset has more than {self._limits.documents:,} JSON and subtree files",
                location=f"{self._store.name}: {path}",
                expected="fewer",
            )

    def read_index(self, path: str) -> JsonObject:
        """Read a ``tileset.json``, and check its required members."""
        data = self._store.read(path, limit=MAX_JSON)
        self.add_bytes(len(data), path)
        document = parse_object(data, f"{path}, ")
        # Those that it names are counted before the first of them is requested.
        self._listed_count += _external_count(document.values)
        self._require_document_limit(self._listed_count, path)
        asset = document.child("asset")
        version = asset.text("version")
        if version not in _SUPPORTED_VERSIONS:
            asset.refuse("version", " or ".join(_SUPPORTED_VERSIONS))
        unknown = set(document.texts("extensionsRequired")) - _SUPPORTED_EXTENSIONS
        if unknown:
            raise TilesetInvalid(
                shorten(sorted(unknown)),
                location=document.at("extensionsRequired"),
                expected=f"extensions that are understood: {', '.join(sorted(_SUPPORTED_EXTENSIONS))}",
            )
        undeclared_extensions = set(document.texts("extensionsRequired")) - set(
            document.texts("extensionsUsed")
        )
        if undeclared_extensions:
            self._report.note(
                TilesetInvalid(
                    shorten(sorted(undeclared_extensions)),
                    location=document.at("extensionsRequired"),
                    expected="extensions that extensionsUsed lists, too",
                )
            )
        document.number("geometricError", least=0)
        return document

    def describe(self, path: str, document: JsonObject, parent_paths: tuple[str, ...]) -> Document:
        """Return the path, metadata classes and referring files of a ``tileset.json``."""
        schema = document.optional("schema")
        if schema is None and "schemaUri" in document:
            location = document.at("schemaUri")
            uri = resolve_uri(path, document.text("schemaUri"), location)
            data = self._store.read(uri, limit=MAX_JSON)
            self.add_bytes(len(data), uri)
            schema = parse_object(data, f"{uri}, ")
        self._report.inspect(document, schema)
        return Document(path, read_classes(schema), (*parent_paths, path))


def _external_count(document: JsonDict) -> int:
    """Return how many external tilesets the tiles of a ``tileset.json`` name."""
    count = 0
    pending: list[object] = [document.get("root")]
    while pending:
        tile = pending.pop()
        if not isinstance(tile, dict):
            continue
        contents = tile.get("contents")
        for content in [tile.get("content"), *(contents if isinstance(contents, list) else ())]:
            uri = (content.get("uri") or content.get("url")) if isinstance(content, dict) else None
            count += isinstance(uri, str) and is_external(uri)
        children = tile.get("children")
        pending += children if isinstance(children, list) else ()
    return count
