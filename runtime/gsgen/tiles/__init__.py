"""3D Tiles of Gaussian splats: how are scenes that exceed the memory stored, read, checked?

    >>> from gsgen.tiles import open_tileset
    >>> tileset = open_tileset("town/tileset.json")

A tileset is a tree of files of splats, coarse above and fine below. An invalid tileset raises
``TilesetInvalid``, which names the file, the JSON path, the actual and the expected value.
"""

from typing import TYPE_CHECKING

from gsgen.contract._lazy import lazy_dir, lazy_getattr

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

__getattr__ = lazy_getattr(__name__)
__dir__ = lazy_dir(__name__)
