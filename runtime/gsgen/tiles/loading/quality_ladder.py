"""Finds each tile's content files at several SPZ qualities, and what each is worth."""

__all__ = ["QualityLadder", "TileQualities", "load_ladder"]

from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.errors import ContentMissing, TilesetInvalid
from gsgen.tiles.format.json_values import is_number
from gsgen.tiles.format.tileset import Tile, Tileset
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.stores.store import Store

_SPZ_WORTH: Final = (0.9997, 0.9958, 0.9844, 0.9840, 0.9661)
"""Worth of files that declare none: SSIM of 20,000 splats at each quality of SPZ."""


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


def load_ladder(store: Store, index: str, tileset: Tileset) -> QualityLadder | None:
    """Return the files of each tile at several qualities, as the tileset tells them.

    Tilesets of gsgen 0.1 do not name the files: siblings ``tileset-qN.json`` do.

    Args:
        store: Of the tileset.
        index: Path of its ``tileset.json``.
        tileset: The tileset.

    Returns:
        None if the metadata tell of no coarser quality than that of the index.
    """
    tiles = tuple(tileset.tiles())
    contents = [tile for tile in tiles if tile.contents]
    counts = {len(tile.file_sizes) for tile in contents}
    finest = tileset.metadata.get("quality", 0)
    count = counts.pop() if len(counts) == 1 else 0
    if not isinstance(finest, int) or not 0 <= finest < count - 1:
        return None
    files = [tile.files for tile in contents]
    if not all(len(uris) == count for uris in files):
        siblings = _sibling_files(store, index, contents)
        files = siblings if all(len(uris) == count for uris in siblings) else []
    if not files:
        return None
    rows = [row for row, tile in enumerate(tiles) if tile.contents]
    all_files: list[tuple[str, ...]] = [()] * len(tiles)
    size, worth = np.full((len(tiles), count), np.inf), np.zeros((len(tiles), count))
    for row, tile, uris in zip(rows, contents, files, strict=True):
        all_files[row], size[row] = uris[finest:], tile.file_sizes
        worth[row] = _worth(tile, count)
    return QualityLadder(
        files=tuple(all_files), size=size[:, finest:], worth=np.ascontiguousarray(worth[:, finest:])
    )


def _worth(tile: Tile, count: int) -> list[float]:
    """Return the declared worth of a tile's files, or that of the first qualities of SPZ."""
    worth = tile.metadata.get("worth")
    if isinstance(worth, list) and len(worth) == count and all(map(is_number, worth)):
        return worth
    return list(_SPZ_WORTH[:: 2 if count < 4 else 1][:count])


def _sibling_files(store: Store, index: str, tiles: list[Tile]) -> list[tuple[str, ...]]:
    """Return each tile's files as the files ``tileset-qN.json`` beside an index name them."""
    uris: list[tuple[str, ...]] = [()] * len(tiles)
    for quality in range(len(_SPZ_WORTH)):
        path = str(PurePosixPath(index).with_name(f"tileset-q{quality}.json"))
        try:
            sibling = [tile for tile in load_tileset(store, path).tiles() if tile.contents]
        except ContentMissing:
            continue
        except TilesetInvalid:
            return []
        if [tile.file_sizes for tile in sibling] != [tile.file_sizes for tile in tiles]:
            return []
        names = [tile.contents[0].uri for tile in sibling]
        uris = [(*before, name) for before, name in zip(uris, names, strict=True)]
    return uris
