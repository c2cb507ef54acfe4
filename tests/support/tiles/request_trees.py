"""Small trees of tiles, ladders and cuts, for tests of the order of requests."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gsgen.tiles.format.tileset import Tile, Tileset
from gsgen.tiles.format.volumes import Box
from gsgen.tiles.loading.quality_ladder import QualityLadder
from gsgen.tiles.selection.cut import TileCut
from gsgen.tiles.selection.tile_tree import TileTree

EYE = np.zeros(3)


def tree_of(parents: Sequence[int], distances: Sequence[float] | None = None) -> TileTree:
    """Tiles in depth-first order with half a side of 1, at distances along x from the origin."""
    places = distances or [5.0] * len(parents)

    def tile(row: int, level: int) -> Tile:
        child_rows = [child for child, parent in enumerate(parents) if parent == row]
        return Tile(
            location=str(row),
            volume=Box(np.array([places[row], 0.0, 0.0]), np.eye(3)),
            geometric_error=1.0,
            refine="REPLACE",
            transform=np.eye(4),
            children=tuple(tile(child, level + 1) for child in child_rows),
            level=level,
        )

    tree = TileTree.of_tileset(
        Tileset(
            name="",
            index="",
            version="1.1",
            geometric_error=1.0,
            transform=np.eye(4),
            root=tile(0, 0),
        )
    )
    return replace(tree, size=np.full(len(tree), 100))


def ladder_of(sizes: Sequence[Sequence[float]], worth: Sequence[float]) -> QualityLadder:
    size = np.array(sizes, np.float64)
    return QualityLadder(files=(), size=size, worth=np.tile(worth, (len(size), 1)))


def cut_of(visible_mask: Sequence[bool], error: Sequence[float]) -> TileCut:
    mask = np.array(visible_mask)
    return TileCut(seen=mask, selected=mask, error=np.array(error))


def ancestors(tree: TileTree, tile: int) -> list[int]:
    """Return the ancestors of a tile, the root last."""
    rows = []
    while (tile := int(tree.parent[tile])) >= 0:
        rows.append(tile)
    return rows
