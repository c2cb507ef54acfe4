"""Decodes tile contents into packed Gaussians, ready for the renderer's GPU memory."""

__all__ = ["ContentReader"]

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import final

import numpy as np

from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE, coefficients
from gsgen.formats.glb.container import Container
from gsgen.formats.shared.splats import Splats
from gsgen.runtime.gpu.morton_order import morton_sorted_indices
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.tiles.errors import ContentMissing, Fault, StoreUnavailable, TilesetInvalid
from gsgen.tiles.format.neural_tile import NeuralTile
from gsgen.tiles.format.tileset import Tile, Tileset
from gsgen.tiles.gltf.container import MAX_CONTENT_BYTES
from gsgen.tiles.gltf.placement import join_placed
from gsgen.tiles.loading.leaves import open_tile_content, place_content
from gsgen.tiles.loading.neural_model import MAX_MODEL
from gsgen.tiles.loading.quality_ladder import TileQualities
from gsgen.tiles.loading.streamed_sog import SogFiles
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.stores.http_store import HttpStore
from gsgen.tiles.stores.store import Store
from gsgen.tiles.streaming.disk_cache import DiskCache, digest_in_path
from gsgen.tiles.streaming.session_frame import TileArrival


@final
class ContentReader:
    """Reads and decodes the contents of tiles; safe to use from many threads.

    Args:
        store: Of the tileset.
        tileset: The tileset.
        tree: Its tiles.
        cache: Keeps files of a server; None to keep nothing.
        qualities: Names the quality at which each tile is read; None for a single quality.
    """

    def __init__(
        self,
        store: Store,
        tileset: Tileset,
        tree: TileTree,
        cache: DiskCache | None,
        *,
        qualities: TileQualities | None = None,
    ) -> None:
        self._tile_qualities = qualities
        self._fetched_quality: dict[int, int] = {}  # of the files that were read last of a tile
        self._store, self._tileset, self._tree = store, tileset, tree
        self._disk_cache = cache if isinstance(store, HttpStore) else None
        self._sog_files = SogFiles()
        degree = tileset.metadata.get("sh_degree")
        known = isinstance(degree, int) and 0 <= degree <= MAX_DEGREE
        self.sh_degree = int(degree) if known else MAX_DEGREE  # type: ignore[arg-type]

    def fetch(self, tile: int, on_bytes: Callable[[int], None]) -> "list[Container | Splats]":
        """Read the content files of a tile, with the buffers that they name.

        Args:
            tile: Key of the tile.
            on_bytes: Called with the number of bytes that came.

        Raises:
            TilesetInvalid: A file is missing, or cannot be read.
        """
        store, size = self._store.for_one_tile(), 0

        def read(uri: str, limit: int = MAX_CONTENT_BYTES) -> bytes:
            nonlocal size
            data = self._file(store, uri, lambda count: on_bytes(size + count), limit)
            size += len(data)
            return data

        containers: list[Container | Splats] = []
        if self._tile_qualities:
            self._fetched_quality[tile] = self._tile_qualities.next_quality(tile)
        for content in self._tile_entry(tile).contents:
            if content.rows is not None:
                with self._full_locations():
                    containers.append(self._sog_files.read(content, read))
                continue
            data = read(content.uri)
            with self._full_locations():
                containers.append(open_tile_content(store, content, data))
        return containers

    def size(self, tile: int) -> int:
        """Return the number of bytes of the files that are requested next for a tile."""
        if self._tile_qualities is None:
            return int(self._tree.size[tile])
        return self._tile_qualities.size(tile, self._tile_qualities.next_quality(tile))

    def read_model(self, neural: NeuralTile) -> bytes:
        """Return the bytes of the ONNX model that a neural tile declares.

        Raises:
            TilesetInvalid: The file is missing, or cannot be read.
        """
        store = self._store.for_large_file()
        return self._file(store, neural.uri, lambda count: None, MAX_MODEL, neural.sha256)

    def _file(
        self,
        store: Store,
        uri: str,
        on_bytes: Callable[[int], None],
        limit: int,
        digest: str | None = None,
    ) -> bytes:
        """Read a file of the tileset; files of web servers come from the disk cache if cached."""
        if not isinstance(store, HttpStore):
            return store.read(uri, limit=limit)
        cache = self._disk_cache
        if cache is None:
            return store.read(uri, limit=limit, on_bytes=on_bytes)
        if digest or digest_in_path(uri):
            cached = cache.get(store.name, uri, digest)
            if cached is not None:
                return cached
            data = store.read(uri, limit=limit, on_bytes=on_bytes)
            cache.put(store.name, uri, data, digest)
            return data
        validator, cached = cache.get_version(store.name, uri)
        version, validator = store.read_version(uri, validator, limit, on_bytes)
        if version is None:
            return cached
        cache.put_version(store.name, uri, validator, version)
        return version

    def decode(self, tile: int, files: "list[Container | Splats]") -> TileArrival:
        """Decode the content files of a tile into packed Gaussians.

        Raises:
            TilesetInvalid: A file is damaged, or its splats are not as many as declared.
        """
        entry = self._tile_entry(tile)
        with self._full_locations():
            placed = [
                part
                for content, container in zip(entry.contents, files, strict=True)
                for part in place_content(self._tileset, entry, content, container)
            ]
        count = sum(map(len, placed))
        declared = entry.metadata.get("splats")
        if isinstance(declared, int | np.integer) and declared != count:
            raise TilesetInvalid(
                f"the tile's contents have {count:,} splats",
                location=self._full_location(entry.contents[0].uri),
                expected=f"{declared:,}, as declared in the metadata of the tile",
                fault=Fault.COUNTS,
            )
        channels = 3 * coefficients(self.sh_degree)
        origin = placed[0].origin if placed else np.zeros(3)
        rows = np.zeros((count, 10), np.float32)
        appearance = np.zeros((count, channels), np.float32)
        if count:
            data = SplatData.from_splats(join_placed(placed, origin))
            order = morton_sorted_indices(data.rows[:, :3])
            rows[:] = data.rows[order]
            shared_channels = min(channels, data.appearance.shape[1])
            appearance[:, :shared_channels] = data.appearance[order, :shared_channels]
        return TileArrival(
            tile=tile,
            rows=rows,
            appearance=appearance,
            origin=origin,
            quality=self._fetched_quality.get(tile, 0),
        )

    def _tile_entry(self, tile: int) -> Tile:
        """Return a tile with the content of the quality fetched last for it."""
        entry = self._tree.tiles[tile]
        if self._tile_qualities is None or not entry.contents:
            return entry
        uri = self._tile_qualities.ladder.files[tile][self._fetched_quality[tile]]
        return replace(entry, contents=(replace(entry.contents[0], uri=uri),))

    @contextmanager
    def _full_locations(self) -> Iterator[None]:
        """Add the address of the web server to the locations of faults in a ``with`` block."""
        try:
            yield
        except (StoreUnavailable, ContentMissing):
            raise
        except TilesetInvalid as error:
            raise TilesetInvalid(
                error.actual,
                location=self._full_location(error.location),
                expected=error.expected,
                hint=error.hint,
                fault=error.fault,
            ) from error

    def _full_location(self, location: str) -> str:
        """Prefix a location in a file with the web address, if the file is on a web server."""
        return f"{self._store.name}/{location}" if isinstance(self._store, HttpStore) else location
