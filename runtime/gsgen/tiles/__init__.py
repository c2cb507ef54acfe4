"""3D Tiles of Gaussian splats: how are scenes that exceed the memory stored, read, checked?

    >>> from gsgen.tiles import open_tileset
    >>> tileset = open_tileset("town/tileset.json")

A tileset is a tree of files of splats, coarse above and fine below. An invalid tileset raises
``TilesetInvalid``, which names the file, the JSON path, the actual and the expected value.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names

if TYPE_CHECKING:
    from gsgen.tiles.loading.info import describe_tileset
    from gsgen.tiles.loading.leaves import open_splats
    from gsgen.tiles.loading.tileset_loader import open_tileset
    from gsgen.tiles.selection.frustum import Frustum
    from gsgen.tiles.streaming.session import SessionOptions, open_session
    from gsgen.tiles.streaming.tiles_source import open_stream
    from gsgen.tiles.validation.rules import all_rules
    from gsgen.tiles.validation.validate import validate

__all__ = [
    "Frustum",
    "SessionOptions",
    "all_rules",
    "describe_tileset",
    "open_session",
    "open_splats",
    "open_stream",
    "open_tileset",
    "validate",
]

# Public name → the module that defines it, or that it is.
_MODULE_BY_NAME: Final = {
    "describe_tileset": "gsgen.tiles.loading.info",
    "open_splats": "gsgen.tiles.loading.leaves",
    "open_tileset": "gsgen.tiles.loading.tileset_loader",
    "Frustum": "gsgen.tiles.selection.frustum",
    "SessionOptions": "gsgen.tiles.streaming.session",
    "open_session": "gsgen.tiles.streaming.session",
    "open_stream": "gsgen.tiles.streaming.tiles_source",
    "all_rules": "gsgen.tiles.validation.rules",
    "validate": "gsgen.tiles.validation.validate",
}

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)
