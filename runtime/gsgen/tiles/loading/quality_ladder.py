"""Finds each tile's content files at several SPZ qualities, and what each is worth."""

__all__ = ["QualityLadder", "TileQualities", "quality_ladder"]

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.format.json_values import is_number
from gsgen.tiles.format.tileset import Tile, Tileset


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class QualityLadder:
    """The content files of each tile at several qualities, finest quality first.

    Attributes:
        files: Address of each tile's content at each quality; empty for tiles without a content.
        size: Bytes of each tile's file at each quality; infinite for tiles without a content.
        worth: What each tile's file shows at each quality, at most 1.
    """

    files: tuple[tuple[str, ...], ...]
    size: Float64[np.ndarray, "n q"]
    worth: Float64[np.ndarray, "n q"]


@final
class TileQualities:
    """The file quality of each tile in GPU memory, and the quality to request next.

    Missing tiles are requested at the coarsest quality, all others at the finest.

    Attributes:
        ladder: The files.
        gpu_quality: Quality of each tile in GPU memory, an index of the ladder; −1 for other tiles.
        coarsest_size: Bytes of each tile's coarsest file; 0 for tiles without a content.
    """

    def __init__(self, ladder: QualityLadder) -> None:
        self.ladder = ladder
        self.gpu_quality: Int64[np.ndarray, " n"] = np.full(len(ladder.size), -1)
        coarsest_sizes = ladder.size[:, -1]
        self.coarsest_size = np.where(np.isfinite(coarsest_sizes), coarsest_sizes, 0).astype(
            np.int64
        )

    def next_quality(self, tile: int) -> int:
        """Return the quality at which a tile is requested next; called on threads."""
        return 0 if self.gpu_quality[tile] >= 0 else self.ladder.size.shape[1] - 1

    def size(self, tile: int, quality: int) -> int:
        """Return the number of bytes of a tile's content file at a quality."""
        return int(self.ladder.size[tile, quality])

    def are_finest(self, tiles: Bool[np.ndarray, " n"]) -> bool:
        """Return whether all tiles of a mask that are in GPU memory have their finest file."""
        return not bool((tiles & (self.gpu_quality > 0)).any())


def quality_ladder(tileset: Tileset) -> QualityLadder | None:
    """Return the files of each tile at several qualities, none finer than that of the index.

    Returns:
        None if a tile with a content does not tell files, bytes and worth of as many qualities as
        the others, or of none that is coarser than that of the index.
    """
    tiles = tuple(tileset.tiles())
    rows = [row for row, tile in enumerate(tiles) if tile.contents]
    finest, count = tileset.metadata.get("quality", 0), max(len(tiles[row].files) for row in rows)
    if not isinstance(finest, int) or not 0 <= finest < count - 1:
        return None
    size, worth = np.full((len(tiles), count), np.inf), np.zeros((len(tiles), count))
    for row in rows:
        told = tiles[row].files, tiles[row].file_sizes, _worth(tiles[row])
        if any(len(entries) != count for entries in told):
            return None
        size[row], worth[row] = told[1:]
    return QualityLadder(
        files=tuple(tile.files[finest:] for tile in tiles),
        size=size[:, finest:],
        worth=np.ascontiguousarray(worth[:, finest:]),
    )


def _worth(tile: Tile) -> list[float]:
    worth = tile.metadata.get("worth")
    return worth if isinstance(worth, list) and all(map(is_number, worth)) else []
