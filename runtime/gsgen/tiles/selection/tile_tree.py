"""The tiles of a tileset as arrays, so that all tiles are culled and compared at once."""

__all__ = ["TileTree", "measure_tile"]

from dataclasses import dataclass, field
from typing import final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.errors import StoreUnavailable, TilesetInvalid
from gsgen.tiles.format.tileset import Tile, Tileset, is_count
from gsgen.tiles.format.volumes import Box, Region, Sphere, Volume
from gsgen.tiles.gltf.container import MAX_CONTENT_BYTES
from gsgen.tiles.loading.limits import LoadingTime
from gsgen.tiles.stores.store import Store

_GLOBE_RADIUS = 6.4e6  # a ball of this radius in metres holds the globe
_LARGE_ANGLE = 0.5
_GRID_POINTS = 5


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TileTree:
    """The tiles of a tileset as arrays, parents first; boxes in the root frame, float64.

    Attributes:
        tiles: The tiles.
        parent: Index of the tile above; −1 for the root.
        level: 0 for the root.
        center: Middles of the bounding boxes, [n, 3].
        half_axes: Vectors from the middle to the faces, as rows, [n, 3, 3].
        error: Geometric error, in units of the root frame.
        is_leaf: Whether there is no tile below.
        is_additive: Whether the tiles below join the content instead of replacing it.
        size: Bytes of the contents; 0 for a tile without.
        splats: Number of splats of the contents, or an estimate from the bytes.
        is_counted: Whether the metadata tell the number of splats of all contents.
        rows_of_level: Indices of the tiles of each level.
    """

    tiles: tuple[Tile, ...] = field(repr=False)
    parent: Int64[np.ndarray, " n"]
    level: Int64[np.ndarray, " n"]
    center: Float64[np.ndarray, "n 3"]
    half_axes: Float64[np.ndarray, "n 3 3"]
    error: Float64[np.ndarray, " n"]
    is_leaf: Bool[np.ndarray, " n"]
    is_additive: Bool[np.ndarray, " n"]
    size: Int64[np.ndarray, " n"]
    splats: Int64[np.ndarray, " n"]
    is_counted: bool = False
    rows_of_level: tuple[Int64[np.ndarray, " m"], ...] = field(repr=False)

    def __len__(self) -> int:
        return len(self.tiles)

    @classmethod
    def of_tileset(cls, tileset: Tileset, store: Store | None = None) -> "TileTree":
        """Flatten the tile tree of a tileset into arrays.

        Args:
            tileset: The tree.
            store: Asked for the sizes that the metadata do not tell; those that it does not tell
                either are 0.

        Raises:
            StoreUnavailable: The sizes take too long.
        """
        tiles: list[Tile] = []
        parents: list[int] = []
        pending = [(tileset.root, -1)]
        while pending:
            tile, parent = pending.pop()
            pending += [(child, len(tiles)) for child in reversed(tile.children)]
            tiles.append(tile)
            parents.append(parent)
        boxes = [_root_box(tile, tileset) for tile in tiles]
        scales = [float(np.linalg.norm(tile.transform[:3, :3], 2)) for tile in tiles]
        tile_measures = _measure_tiles(tiles, tileset, store)
        level = np.array([tile.level for tile in tiles], np.int64)
        return cls(
            tiles=tuple(tiles),
            parent=np.array(parents, np.int64),
            level=level,
            center=np.array([box.center for box in boxes]),
            half_axes=np.array([box.half_axes for box in boxes]),
            error=np.array([tile.geometric_error for tile in tiles]) * scales,
            is_leaf=np.array([not tile.children for tile in tiles]),
            is_additive=np.array([tile.refine == "ADD" for tile in tiles]),
            size=np.array([size for size, _ in tile_measures], np.int64),
            splats=np.array([splats for _, splats in tile_measures], np.int64),
            is_counted=all(_has_counts(tile) for tile in tiles if tile.contents),
            rows_of_level=tuple(
                np.flatnonzero(level == depth) for depth in range(int(level.max()) + 1)
            ),
        )

    def box(self, tile: int) -> Box:
        """Return a tile's bounding box in the root frame."""
        return Box(self.center[tile], self.half_axes[tile])

    def with_ancestors(self, tiles: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return the mask of some tiles with all ancestors of these tiles added."""
        mask = tiles.copy()
        for rows in reversed(self.rows_of_level[1:]):
            mask[self.parent[rows[mask[rows]]]] = True
        return mask


_BYTES_PER_SPLAT = 14  # of SPZ at degree 0: an estimate where the metadata do not count


def _measure_tiles(
    tiles: list[Tile], tileset: Tileset, store: Store | None
) -> list[tuple[int, int]]:
    """Return the bytes and splats of tiles, for which a server may have to be asked.

    A content whose size the server does not tell fails when it is fetched, if it is fetched.
    """
    time, measures = LoadingTime(tileset.name), []
    for tile in tiles:
        try:
            measures.append(measure_tile(tile, tileset, store))
        except TilesetInvalid as error:
            measures.append(measure_tile(tile, tileset, None))
            if isinstance(error, StoreUnavailable):
                store = None  # or each of many tiles would wait for a server that does not answer
        time.require(f"the sizes of {len(measures):,} of {len(tiles):,} tiles")
    return measures


def measure_tile(tile: Tile, tileset: Tileset, store: Store | None) -> tuple[int, int]:
    """Return the number of bytes and of splats in a tile's contents."""
    if not tile.contents:
        return 0, 0
    quality, listed_sizes = tileset.metadata.get("quality", 0), tile.file_sizes
    size = 0
    if listed_sizes and isinstance(quality, int):
        size = listed_sizes[min(max(quality, 0), len(listed_sizes) - 1)]
    elif store is not None:
        sizes = [store.size(content.uri) for content in tile.contents]
        size = (
            sum(sizes) if max(sizes) <= MAX_CONTENT_BYTES else 0
        )  # reading it says that it is too large
    if _has_counts(tile):
        return size, int(tile.metadata["splats"])
    return size, size // _BYTES_PER_SPLAT


def _has_counts(tile: Tile) -> bool:
    """Return whether a tile's metadata tell the number of its splats."""
    return is_count(tile.metadata.get("splats"))


def _root_box(tile: Tile, tileset: Tileset) -> Box:
    """Return a box in the root frame that contains a tile's bounding volume."""
    volume: Volume = tile.volume
    if isinstance(volume, Region):
        return _region_box(volume).transformed(np.linalg.inv(tileset.transform))
    volume = volume.transformed(tile.transform)
    if isinstance(volume, Sphere):
        return Box(volume.center, np.eye(3) * volume.radius)
    assert isinstance(volume, Box)
    return volume


def _region_box(region: Region) -> Box:
    """Return a box around a region of the globe, aligned to the region's middle."""
    height = region.north - region.south
    if max(region.width, height) > _LARGE_ANGLE:
        return Box(np.zeros(3), np.eye(3) * (_GLOBE_RADIUS + max(region.maximum, 0.0)))
    cells = range(_GRID_POINTS)
    points = np.concatenate([_region_cell(region, x, y).samples() for x in cells for y in cells])
    east_longitude = region.west + region.width / 2
    north = (region.south + region.north) / 2
    axes = np.array(
        [
            [-np.sin(east_longitude), np.cos(east_longitude), 0],
            [
                -np.sin(north) * np.cos(east_longitude),
                -np.sin(north) * np.sin(east_longitude),
                np.cos(north),
            ],
            [
                np.cos(north) * np.cos(east_longitude),
                np.cos(north) * np.sin(east_longitude),
                np.sin(north),
            ],
        ]
    )
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    # Between samples the globe bulges by less than r·(angle/step)²/8.
    curvature_sag = _GLOBE_RADIUS * (max(region.width, height) / (2 * _GRID_POINTS)) ** 2 / 8
    half_size = (high - low) / 2 + curvature_sag
    return Box((low + high) / 2 @ axes, axes * half_size[:, None])


def _region_cell(region: Region, x: int, y: int) -> Region:
    """Return one cell of a regular grid that divides a region of the globe."""
    width, height = region.width / _GRID_POINTS, (region.north - region.south) / _GRID_POINTS
    west, south = region.west + width * x, region.south + height * y
    return Region(
        west=west,
        south=south,
        east=west + width,
        north=south + height,
        minimum=region.minimum,
        maximum=region.maximum,
    )
