"""Reads splats of a tileset, from all leaf tiles or one tile, in the root tile's frame."""

__all__ = [
    "finest_contents",
    "open_splats",
    "open_tile_content",
    "place_content",
    "read_contents",
    "read_leaves",
]

import os
import posixpath
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsgen.formats import open_splats as open_splat_file
from gsgen.formats.glb.container import Container
from gsgen.formats.shared.origins import Origin, with_origin
from gsgen.formats.shared.splats import MAX_FLOAT32_OFFSET, PackedRows, PointCloud, Splats
from gsgen.formats.tileset_paths import names_tileset
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.tileset import Content, Tile, Tileset
from gsgen.tiles.format.uris import resolve_uri
from gsgen.tiles.gltf.container import MAX_CONTENT_BYTES, open_content
from gsgen.tiles.gltf.decoding import decode_content
from gsgen.tiles.gltf.placement import PlacedSplats, join_placed, place
from gsgen.tiles.loading.streamed_sog import SogFiles
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.stores.store import Store


def read_contents(
    store: Store,
    tileset: Tileset,
    contents: Iterable[tuple[Tile, Content]],
    sog_files: SogFiles | None = None,
) -> list[PlacedSplats]:
    """Return the splats of contents of tiles in the frame of the root tile.

    Args:
        store: Of the tileset.
        tileset: The tileset.
        contents: Each with its tile.
        sog_files: Files of a streamed SOG that were decoded before; None for none.

    Raises:
        TilesetInvalid: A file is missing or wrong.
        StoreUnavailable: A file cannot be read now.
    """
    sog_files = sog_files or SogFiles()
    return [
        part
        for tile, content in contents
        for part in place_content(
            tileset, tile, content, _opened(store.for_one_tile(), content, sog_files)
        )
    ]


def _opened(store: Store, content: Content, sog_files: SogFiles) -> Container | Splats:
    if content.rows is not None:
        return sog_files.read(content, lambda file, limit: store.read(file, limit=limit))
    data = store.read(content.uri, limit=MAX_CONTENT_BYTES)
    return open_tile_content(store, content, data)


def open_tile_content(store: Store, content: Content, data: bytes) -> Container:
    """Open a tile's content file whose bytes were read; its buffers may be in other files."""

    def fetch(uri: str, location: str, size: int) -> bytes:
        path = resolve_uri(content.uri, uri, location)
        return store.read(path, size=size, limit=MAX_CONTENT_BYTES)

    return open_content(data, content.uri, fetch)


def place_content(
    tileset: Tileset, tile: Tile, content: Content, opened: Container | Splats
) -> list[PlacedSplats]:
    """Decode the splats of a tile's content, in the frame of the root tile."""
    if isinstance(opened, Splats):  # rows of a SOG file
        parts = [(opened, np.eye(4))]
    else:
        parts = decode_content(opened, content.uri)
    return [
        place(splats, tile.transform @ tileset.content_axes @ matrix)
        for splats, matrix in parts
        if len(splats)
    ]


def finest_contents(tileset: Tileset) -> Iterator[tuple[Tile, Content]]:
    """Yield the tile contents that are drawn at the finest level of detail."""
    for tile in tileset.tiles():
        if tile.is_finest:
            for content in tile.contents:
                yield tile, content


def open_splats(
    path: str | os.PathLike[str], *, drop_invalid: bool = False, origin: Origin | None = None
) -> Splats | PointCloud | PackedRows:
    """Read a splat file of any format, or all leaf tiles of a tileset as one set of splats.

    Args:
        path: A file, a tileset (tileset.json, its folder, .3tz), or an address.
        drop_invalid: Drop rows of a PLY file that cannot be drawn, and warn about them.
        origin: The point that positions become relative to; None for one that float32 needs.

    Raises:
        FormatError: The file cannot be read.
        TilesetInvalid: A file of the tileset is missing or wrong.
        StoreUnavailable: The store cannot be read now.
    """
    if names_tileset(path):
        return read_leaves(path, origin)
    return open_splat_file(path, drop_invalid=drop_invalid, origin=origin)


def read_leaves(
    source: str | os.PathLike[str], origin: Origin | None = None
) -> Splats | PointCloud | PackedRows:
    """Return the splats of all leaf tiles of a tileset as one set, in the root tile's frame.

    Where the root frame is so large that float32 would lose millimetres, positions are
    relative to the middle of the splats. Origins are those of the scene that the tileset was built
    from, where its metadata declares one; a ``FormatWarning`` reports them. A given ``origin`` takes
    their place.

    Raises:
        TilesetInvalid: A file is missing or wrong, or there are no splats.
        StoreUnavailable: The store cannot be read now.
    """
    store, index = open_store(os.fspath(source))
    with store:
        tileset = load_tileset(store, index, name=str(source))
        parts = read_contents(store, tileset, finest_contents(tileset))
    if not parts:
        raise TilesetInvalid(
            "no leaf tile has splats",
            location=posixpath.basename(index),
            expected="contents with KHR_gaussian_splatting",
            fault=Fault.CONTENT,
        )
    middle: Float64[np.ndarray, " 3"] = np.round(
        np.stack([part.origin for part in parts]).mean(axis=0)
    )
    if np.abs(middle).max() <= MAX_FLOAT32_OFFSET:
        middle = np.zeros(3)
    splats = join_placed(parts, middle)
    x, y, z = (float(value) for value in middle + tileset.origin)
    return with_origin(replace(splats, origin=(x, y, z)), origin, source)
