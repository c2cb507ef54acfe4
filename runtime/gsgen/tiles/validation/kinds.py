"""The kinds of input that the rules of tilesets (GT) check."""

__all__ = ["TILESET", "TILE_CONTENT"]

from typing import Final

TILESET: Final = "tileset"
TILE_CONTENT: Final = "tile-content"
