"""Reads a tileset: ``tileset.json``, external tilesets and subtrees become one tile tree."""

__all__ = ["Limits", "LoadReport", "load_tileset", "open_tileset"]

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.file_kinds.names import STREAMED_META
from gsgen.formats.tileset_paths import INDEX_FILE
from gsgen.tiles.errors import ContentMissing, Fault, TilesetInvalid
from gsgen.tiles.format.extensions import CONTENT_EXTENSION
from gsgen.tiles.format.implicit_tiling.subtree import Subtree, read_subtree
from gsgen.tiles.format.implicit_tiling.tree import (
    ImplicitTree,
    TileCoordinates,
    expand_implicit,
    read_implicit,
)
from gsgen.tiles.format.json_values import JsonDict, JsonObject, shorten
from gsgen.tiles.format.metadata import FILES_PROPERTY
from gsgen.tiles.format.neural_tile import NEURAL_TILE_EXTENSION as NEURAL
from gsgen.tiles.format.neural_tile import NeuralTile, read_neural_tile
from gsgen.tiles.format.tileset import Content, RefineMode, Tile, Tileset
from gsgen.tiles.format.uris import is_external, resolve_uri
from gsgen.tiles.format.volumes import read_volume
from gsgen.tiles.loading.documents import Document, DocumentReader
from gsgen.tiles.loading.limits import Limits, LoadReport, StrictReport
from gsgen.tiles.loading.streamed_sog import is_streamed_sog, load_streamed_sog
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.stores.store import Store

Matrix = Float64[np.ndarray, "4 4"]

_MAX_SUBTREE: Final = 64 << 20


def open_tileset(source: str | Path, *, limits: Limits | None = None) -> Tileset:
    """Read the tree of tiles of a tileset from a path or address; contents are not read.

    Args:
        source: ``tileset.json``, its folder, a ``.3tz`` archive, or an address.
        limits: How much is read.

    Raises:
        TilesetInvalid: A file is missing or wrong; the error names it and the JSON path.
    """
    store, index = open_store(source)
    with store:
        return load_tileset(store, index, limits=limits, name=str(source))


def load_tileset(
    store: Store,
    index: str,
    *,
    limits: Limits | None = None,
    report: LoadReport | None = None,
    name: str = "",
) -> Tileset:
    """Read the tree of tiles of a tileset from a file store; contents are not read.

    Args:
        store: Where its files lie.
        index: Path of ``tileset.json``, or of the ``lod-meta.json`` of a streamed SOG; that is
            also read, without a ``report``, in place of a ``tileset.json`` that is missing.
        limits: How much is read.
        report: Receives the faults; without it, the first one is raised.
        name: Name of the tileset in messages.

    Raises:
        TilesetInvalid: The index cannot be read at all, or something in it and ``report``
            raises.
    """
    limits, name = limits or Limits(), name or store.name
    if is_streamed_sog(index):
        return load_streamed_sog(store, index, limits, name)
    try:
        return _Loader(store, limits, report or StrictReport()).tileset(index, name)
    except ContentMissing as error:
        if index != INDEX_FILE or report is not None:
            raise
        try:  # a folder or an address of one may hold the other kind
            return load_streamed_sog(store, STREAMED_META, limits, name)
        except ContentMissing:
            raise error from None


@final
@dataclass(frozen=True, slots=True)
class _Parent:
    """The properties that a tile inherits from its parent."""

    transform: Matrix
    refine: RefineMode
    level: int


@final
class _Loader:
    def __init__(self, store: Store, limits: Limits, report: LoadReport) -> None:
        self._store, self._limits, self._report = store, limits, report
        self._documents = DocumentReader(store, limits, report)
        self._tiles = 0
        self._file_templates: tuple[str, ...] = ()  # of implicit tiles, by quality

    def tileset(self, index: str, name: str) -> Tileset:
        """Read the outermost ``tileset.json`` of a tileset."""
        document = self._documents.read_index(index)
        asset = document.child("asset")
        source = self._documents.describe(index, document, ())
        metadata = _metadata_properties(document.optional("metadata"))
        templates = metadata.get(FILES_PROPERTY)
        if isinstance(templates, list) and all(isinstance(uri, str) for uri in templates):
            self._file_templates = tuple(templates)
        root = document.child("root")
        transform = self._read_transform(root)
        parent = _Parent(np.eye(4), "REPLACE", 0)
        tree = self._tile(root, source, parent, own_transform=np.eye(4))
        extensions = document.optional("extensions")
        gltf = extensions.optional(CONTENT_EXTENSION) if extensions else None
        return Tileset(
            name=name,
            index=index,
            version=asset.text("version"),
            geometric_error=document.number("geometricError", least=0),
            transform=transform,
            root=tree,
            extensions_used=document.texts("extensionsUsed"),
            extensions_required=document.texts("extensionsRequired"),
            content_extensions=gltf.texts("extensionsRequired") if gltf else None,
            metadata=metadata,
            y_up=asset.values.get("gltfUpAxis", "Y") != "Z",
        )

    def _tile(
        self,
        entry: JsonObject,
        document: Document,
        parent: _Parent,
        own_transform: Matrix | None = None,
    ) -> Tile:
        """Read a tile and all its descendants."""
        if parent.level >= self._limits.depth:
            raise TilesetInvalid(
                f"the tileset has more than {self._limits.depth} levels of tiles",
                location=entry.location,
                expected="fewer",
            )
        self._count_tiles(1, entry.location)
        volume = read_volume(entry.child("boundingVolume"))
        local_transform = self._read_transform(entry) if own_transform is None else own_transform
        transform = parent.transform @ local_transform
        error, refine = (
            entry.number("geometricError", least=0),
            self._read_refine_mode(entry, parent),
        )
        tile = Tile(
            location=entry.location,
            volume=volume,
            geometric_error=error,
            refine=refine,
            transform=transform,
            level=parent.level,
            metadata=_metadata_properties(entry.optional("metadata")),
            neural=self._read_neural_tile(entry, document),
        )
        if "implicitTiling" in entry:
            return self._expand_implicit(entry, tile, document)
        below = _Parent(transform, refine, parent.level + 1)
        contents, external_tiles = self._contents(entry, document, below)
        children = [*external_tiles]
        files: list[str] = []
        self._read_or_report(partial(self._append_files, files, entry, tile, document))
        for child in self._child_entries(entry):
            self._read_or_report(partial(self._append_tile, children, child, document, below))
        return replace(tile, contents=contents, children=tuple(children), files=tuple(files))

    def _append_files(
        self, files: list[str], entry: JsonObject, tile: Tile, document: Document
    ) -> None:
        """Append the files of a tile at each quality, as its metadata name them."""
        uris = tile.metadata.get(FILES_PROPERTY)
        if isinstance(uris, list) and all(isinstance(uri, str) for uri in uris):
            location = f"{entry.at('metadata')}.properties.{FILES_PROPERTY}"
            files += [resolve_uri(document.path, uri, location) for uri in uris]

    def _append_tile(
        self, children: list[Tile], entry: JsonObject, document: Document, parent: _Parent
    ) -> None:
        children.append(self._tile(entry, document, parent))

    def _read_or_report(self, read: Callable[[], None]) -> None:
        """Read a part of a tileset; report the fault and omit the part if the part is invalid."""
        try:
            read()
        except TilesetInvalid as error:
            self._report.drop(error)

    def _count_tiles(self, tiles: int, location: str) -> None:
        self._tiles += tiles
        if self._tiles > self._limits.tiles:
            raise TilesetInvalid(
                f"the tileset has more than {self._limits.tiles:,} tiles",
                location=location,
                expected="fewer",
            )

    def _read_refine_mode(self, entry: JsonObject, parent: _Parent) -> RefineMode:
        refine = entry.values.get("refine", parent.refine)
        if refine == "ADD":
            return "ADD"
        if refine != "REPLACE":
            entry.refuse("refine", "ADD or REPLACE")
        return "REPLACE"

    def _child_entries(self, entry: JsonObject) -> list[JsonObject]:
        children: list[JsonObject] = []
        self._read_or_report(lambda: children.extend(entry.objects("children")))
        if entry.values.get("children") == []:
            self._report.note(
                TilesetInvalid(
                    "an empty array",
                    location=entry.at("children"),
                    expected="at least one child, or no member `children`",
                )
            )
        return children

    def _read_transform(self, entry: JsonObject) -> Matrix:
        """Return the transform of a tile; raise for one that mirrors or flattens."""
        if "transform" not in entry:
            return np.eye(4)
        matrix = entry.numbers("transform", 16).reshape(4, 4).T
        if not np.array_equal(matrix[3], [0, 0, 0, 1]):
            raise TilesetInvalid(
                f"the last row of the transform is {shorten(matrix[3].tolist())}",
                location=entry.at("transform"),
                expected="0 0 0 1: 16 numbers, column by column",
                fault=Fault.TRANSFORM,
            )
        sizes = np.linalg.svd(matrix[:3, :3], compute_uv=False)
        if not (np.linalg.det(matrix[:3, :3]) > 0 and np.isfinite(sizes).all()):
            raise TilesetInvalid(
                "the transform mirrors or flattens",
                location=entry.at("transform"),
                expected="a rotation, a positive scale and a translation",
                fault=Fault.TRANSFORM,
            )
        return matrix

    def _contents(
        self, entry: JsonObject, document: Document, below: _Parent
    ) -> tuple[tuple[Content, ...], list[Tile]]:
        """Return the contents of a tile, and the roots of the external tilesets among them."""
        if "content" in entry and "contents" in entry:
            self._report.note(
                TilesetInvalid(
                    "content and contents",
                    location=entry.location,
                    expected="one of the two members",
                )
            )
        contents: list[Content] = []
        external_tiles: list[Tile] = []
        entries = [entry.child("content")] if "content" in entry else []
        entries += entry.objects("contents")
        for content in entries:
            read = partial(self._content, content, document, below, contents, external_tiles)
            self._read_or_report(read)
        return tuple(contents), external_tiles

    def _content(
        self,
        entry: JsonObject,
        document: Document,
        below: _Parent,
        contents: list[Content],
        external_tiles: list[Tile],
    ) -> None:
        key = "url" if "uri" not in entry and "url" in entry else "uri"  # url: of 1.0
        uri = resolve_uri(document.path, entry.text(key), entry.at(key))
        if is_external(uri):
            external_tiles.append(self._load_external(uri, entry.at(key), document, below))
            return
        bounds = entry.optional("boundingVolume")
        volume = read_volume(bounds) if bounds else None
        contents.append(Content(uri=uri, volume=volume, location=entry.at(key)))

    def _load_external(self, uri: str, location: str, document: Document, below: _Parent) -> Tile:
        if uri in document.parent_paths:
            raise TilesetInvalid(
                f"the external tileset {uri} is nested within itself",
                location=location,
                expected="external tilesets that do not come back to this one",
                fault=Fault.URI,
            )
        if len(document.parent_paths) > self._limits.nesting:
            raise TilesetInvalid(
                f"more than {self._limits.nesting} external tilesets are nested",
                location=location,
                expected="fewer",
                fault=Fault.URI,
            )
        inner = self._documents.read_index(uri)
        source = self._documents.describe(uri, inner, document.parent_paths)
        return self._tile(inner.child("root"), source, below)

    def _read_neural_tile(self, entry: JsonObject, document: Document) -> NeuralTile | None:
        extensions = entry.optional("extensions")
        if extensions is None or NEURAL not in extensions:
            return None
        try:
            return read_neural_tile(extensions.child(NEURAL), document.path)
        except TilesetInvalid as error:
            self._report.note(error)  # the content stays, and is drawn instead
            return None

    def _expand_implicit(self, entry: JsonObject, tile: Tile, document: Document) -> Tile:
        self._count_tiles(-1, entry.location)
        tree = read_implicit(
            entry,
            tile.volume,
            tile.geometric_error,
            tile.refine,
            document.path,
            document.classes,
            self._file_templates if not document.parent_paths[1:] else (),
        )

        def load(tree: ImplicitTree, origin: TileCoordinates) -> Subtree | None:
            try:
                return self._subtree(tree, origin)
            except TilesetInvalid as error:
                self._report.drop(error)
                return None

        return expand_implicit(tree, tile, load, self._count_tiles)

    def _subtree(self, tree: ImplicitTree, origin: TileCoordinates) -> Subtree:
        uri = tree.uri(tree.subtree_uri, origin, f"{tree.location}.implicitTiling.subtrees.uri")
        data = self._store.read(uri, limit=_MAX_SUBTREE)
        self._documents.add_bytes(len(data), uri)

        def read_buffer(name: str, location: str, size: int) -> bytes:
            path = resolve_uri(uri, name, location)
            self._documents.add_bytes(size, path)
            return self._store.read(path, size=size, limit=_MAX_SUBTREE)

        return read_subtree(
            data,
            uri,
            branching=tree.branching,
            levels=tree.subtree_levels,
            classes=tree.classes,
            read_buffer=read_buffer,
            inspect=self._report.inspect_subtree,
        )


def _metadata_properties(metadata: JsonObject | None) -> JsonDict:
    """Return the properties of a 3D Tiles metadata entity."""
    properties = metadata.optional("properties") if metadata else None
    return dict(properties.values) if properties else {}
