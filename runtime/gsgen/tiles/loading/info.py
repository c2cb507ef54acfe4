"""Counts the tiles, splats and bytes of a tileset at each level."""

__all__ = ["LevelInfo", "TilesetInfo", "describe_tileset"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from gsgen.tiles.format.tileset import Content, Tile, Tileset, is_count
from gsgen.tiles.gltf.container import MAX_CONTENT_BYTES
from gsgen.tiles.gltf.decoding import ContentHeader, read_header
from gsgen.tiles.loading.leaves import open_tile_content
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.stores.store import Store


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LevelInfo:
    """The numbers of tiles, splats and bytes of one level of a tileset.

    Attributes:
        level: 0 for the root.
        tiles: How many have content.
        splats: In all of them.
        bytes: Of all their files.
        geometric_error: The largest.
    """

    level: int
    tiles: int
    splats: int
    bytes: int
    geometric_error: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TilesetInfo:
    """The numbers of tiles, splats and bytes of a tileset, in all and by level.

    Attributes:
        tiles: How many tiles there are, with and without content.
        splats: In all contents.
        leaf_splats: In the contents that are drawn at the finest.
        bytes: Of all contents.
        sh_degree: The highest of the contents.
        refine: Of the root.
        levels: The levels, the root's first.
        box: Lower and upper corner of the root's volume, in the root frame; of a region, in
            the world.
        transform: From the root frame to the world, row by row.
        extensions: glTF extensions that the contents require, as the tileset declares them.
        neural: How many tiles hold a generator.
        quality_bytes: Bytes of all contents at each quality, finest first; empty unless all tiles
            tell them for several qualities.
    """

    tiles: int
    splats: int
    leaf_splats: int
    bytes: int
    sh_degree: int
    refine: str
    levels: tuple[LevelInfo, ...]
    box: tuple[tuple[float, ...], tuple[float, ...]]
    transform: tuple[tuple[float, ...], ...]
    extensions: tuple[str, ...]
    neural: int
    quality_bytes: tuple[int, ...]


@final
@dataclass(frozen=True, slots=True)
class _MeasuredFile:
    splats: int
    size: int
    degree: int


def describe_tileset(source: str | Path) -> TilesetInfo:
    """Return the numbers of tiles, splats and bytes of the tileset at ``source``.

    Numbers come from metadata where the tileset has them, else from the files' headers.

    Raises:
        TilesetInvalid: A file is missing or wrong.
        StoreUnavailable: The store cannot be read now.
    """
    store, index = open_store(source)
    with store:
        tileset = load_tileset(store, index, name=str(source))
        return _describe_loaded_tileset(store, tileset)


def _describe_loaded_tileset(store: Store, tileset: Tileset) -> TilesetInfo:
    profile = tileset.metadata
    known: dict[str, _MeasuredFile] = {}
    levels: dict[int, list[tuple[Tile, _MeasuredFile]]] = {}
    tiles = list(tileset.tiles())
    for tile in tiles:
        for content in tile.contents:
            measured = _measured_from_metadata(tile, profile)
            if measured is None:
                if content.uri not in known:
                    known[content.uri] = _measured_from_header(store, content)
                measured = known[content.uri]
            levels.setdefault(tile.level, []).append((tile, measured))
    measured_pairs = [pair for pairs in levels.values() for pair in pairs]
    samples = tileset.root.volume.samples()
    low, high = samples.min(axis=0), samples.max(axis=0)
    return TilesetInfo(
        tiles=len(tiles),
        splats=sum(entry.splats for _, entry in measured_pairs),
        leaf_splats=sum(entry.splats for tile, entry in measured_pairs if tile.is_finest),
        bytes=sum(entry.size for _, entry in measured_pairs),
        sh_degree=max((entry.degree for _, entry in measured_pairs), default=0),
        refine=tileset.root.refine,
        levels=tuple(_level(level, levels[level]) for level in sorted(levels)),
        box=(tuple(map(float, low)), tuple(map(float, high))),
        transform=tuple(tuple(map(float, row)) for row in tileset.transform),
        extensions=tileset.content_extensions or (),
        neural=sum(tile.neural is not None for tile in tiles),
        quality_bytes=_quality_bytes([tile for tile in tiles if tile.contents]),
    )


def _quality_bytes(tiles: list[Tile]) -> tuple[int, ...]:
    sizes = [tile.file_sizes for tile in tiles]
    has_qualities = len(set(map(len, sizes))) == 1 and len(sizes[0]) > 1
    return tuple(map(sum, zip(*sizes, strict=True))) if has_qualities else ()


def _level(level: int, pairs: list[tuple[Tile, _MeasuredFile]]) -> LevelInfo:
    return LevelInfo(
        level=level,
        tiles=len({id(tile) for tile, _ in pairs}),
        splats=sum(entry.splats for _, entry in pairs),
        bytes=sum(entry.size for _, entry in pairs),
        geometric_error=max(tile.geometric_error for tile, _ in pairs),
    )


def _measured_from_metadata(tile: Tile, profile: Mapping[str, Any]) -> _MeasuredFile | None:
    """Return a tile's splats, bytes and SH degree from gsgen metadata; None if one is missing."""
    degree, quality = profile.get("sh_degree"), profile.get("quality", 0)
    splats, sizes = tile.metadata.get("splats"), tile.file_sizes
    if not (isinstance(quality, int) and quality >= 0 and isinstance(degree, int)):
        return None
    if not (sizes and is_count(splats)):
        return None
    return _MeasuredFile(int(splats or 0), sizes[min(quality, len(sizes) - 1)], degree)


def _measured_from_header(store: Store, content: Content) -> _MeasuredFile:
    store = store.for_one_tile()
    data = store.read(content.uri, limit=MAX_CONTENT_BYTES)
    container = open_tile_content(store, content, data)
    header: ContentHeader = read_header(container, content.uri, len(data))
    return _MeasuredFile(header.splats, header.size, header.sh_degree)
