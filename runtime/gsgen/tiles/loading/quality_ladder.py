"""Finds each tile's content files at several SPZ qualities, in files ``tileset-qN.json``."""

__all__ = ["QualityLadder", "TileQualities", "load_ladder"]

from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.errors import ContentMissing, TilesetInvalid
from gsgen.tiles.format.tileset import Tile, Tileset
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.stores.store import Store

SSIM: Final = (0.9997, 0.9958, 0.9844, 0.9840, 0.9661)
"""SSIM to the unrounded splats at each SPZ quality: 20,000 of degree 3, from a middle distance."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class QualityLadder:
    """The content files of each tile at several qualities, finest quality first.

    Attributes:
        tiles: Tiles of each quality, depth first; they differ in their contents alone.
        size: Bytes of each tile's file at each quality; infinite for tiles without a content.
        quality_scores: What a file shows at each quality, at most 1.
    """

    tiles: tuple[tuple[Tile, ...], ...]
    size: Float64[np.ndarray, "n q"]
    quality_scores: Float64[np.ndarray, " q"]


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
        return 0 if self.gpu_quality[tile] >= 0 else len(self.ladder.quality_scores) - 1

    def size(self, tile: int, quality: int) -> int:
        """Return the number of bytes of a tile's content file at a quality."""
        return int(self.ladder.size[tile, quality])

    def are_finest(self, tiles: Bool[np.ndarray, " n"]) -> bool:
        """Return whether all tiles of a mask that are in GPU memory have their finest file."""
        return not bool((tiles & (self.gpu_quality > 0)).any())


def load_ladder(store: Store, index: str, tileset: Tileset) -> QualityLadder | None:
    """Read the files ``tileset-qN.json`` beside a tileset, in descending order of quality.

    Args:
        store: Of the tileset.
        index: Path of its ``tileset.json``.
        tileset: The tileset.

    Returns:
        None if the metadata name no coarser quality, or siblings are missing or are other trees.
    """
    tiles = tuple(tileset.tiles())
    sizes = [_sizes(tile) for tile in tiles]
    count = max(map(len, sizes))
    if count < 2 or any(len(size) not in (0, count) for size in sizes):
        return None
    ladder: dict[int, tuple[Tile, ...]] = {}
    for quality in range(len(SSIM)):
        path = str(PurePosixPath(index).with_name(f"tileset-q{quality}.json"))
        try:
            sibling_tileset = load_tileset(store, path)
        except ContentMissing:
            continue
        except TilesetInvalid:
            return None
        ladder[quality] = tuple(sibling_tileset.tiles())
    have_same_tree = all(
        _is_same_tree(tiles, sibling_tileset) for sibling_tileset in ladder.values()
    )
    if len(ladder) != count or not have_same_tree:
        return None
    finest_quality = tileset.metadata.get("quality", 0)
    if not isinstance(finest_quality, int) or not 0 <= finest_quality < count - 1:
        return None
    missing_errors = [np.inf] * count
    return QualityLadder(
        tiles=tuple(ladder.values())[finest_quality:],
        size=np.array([size or missing_errors for size in sizes], np.float64)[:, finest_quality:],
        quality_scores=np.array([SSIM[quality] for quality in ladder])[finest_quality:],
    )


def _sizes(tile: Tile) -> list[int]:
    sizes = tile.metadata.get("bytes")
    return [int(size) for size in sizes] if isinstance(sizes, list) and tile.contents else []


def _is_same_tree(tiles: tuple[Tile, ...], other_tiles: tuple[Tile, ...]) -> bool:
    return len(tiles) == len(other_tiles) and all(
        tile.level == other_tile.level
        and len(tile.contents) == len(other_tile.contents) <= 1
        and tile.metadata.get("bytes") == other_tile.metadata.get("bytes")
        for tile, other_tile in zip(tiles, other_tiles, strict=True)
    )
