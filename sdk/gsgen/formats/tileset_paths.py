"""Recognises paths and addresses of tilesets (3D Tiles) by their names, without reading them."""

__all__ = ["INDEX", "names_tileset", "names_tileset_or_content"]

import os
from pathlib import Path
from typing import Final

from gsgen.formats.codecs import codec_named

INDEX: Final = "tileset.json"
"""The file in a tileset's folder that lists its tiles."""

_ADDRESSES: Final = ("http:/", "https:/")  # ``Path`` removes the second slash
_CONTENTS: Final = (".glb", ".gltf")


def names_tileset(path: str | os.PathLike[str]) -> bool:
    """Return whether a path names a tileset: a file by its suffix, an address, or a folder."""
    text = os.fspath(path)
    name = Path(text).name.lower()
    if text.lower().startswith(_ADDRESSES) or name.endswith(".3tz"):
        return True
    if name.endswith(".json"):
        return name not in codec_named("sog").suffixes
    return (Path(text) / INDEX).is_file()


def names_tileset_or_content(path: Path) -> bool:
    """Return whether `gsgen validate` checks ``path`` by the rules of tilesets."""
    return path.suffix.lower() in (*_CONTENTS, ".json") or names_tileset(path)
