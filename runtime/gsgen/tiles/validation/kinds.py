"""The kinds of input that the rules of tilesets (GT) and of scene files (GC) check."""

__all__ = ["SCENE", "TILESET", "TILE_CONTENT"]

from typing import Final

TILESET: Final = "tileset"
TILE_CONTENT: Final = "tile-content"
SCENE: Final = "scene"
