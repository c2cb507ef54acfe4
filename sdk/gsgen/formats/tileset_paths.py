"""Recognises paths and addresses of tilesets (3D Tiles): by names, JSON files by their content."""

__all__ = ["INDEX_FILE", "names_tileset", "names_tileset_or_content"]

import os
from pathlib import Path
from typing import Final

from gsgen.contract.file_kinds.recognition import kind_of_file
from gsgen.formats.codecs import codec_named

INDEX_FILE: Final = "tileset.json"
"""The file in a tileset's folder that lists its tiles."""

_URL_PREFIXES: Final = ("http:/", "https:/")  # ``Path`` removes the second slash
_CONTENT_SUFFIXES: Final = (".glb", ".gltf")


def names_tileset(path: str | os.PathLike[str]) -> bool:
    """Return whether a path names a tileset: an address, an archive, JSON, or a folder.

    A JSON file is one unless its content is known to be something else.
    """
    text = os.fspath(path)
    name = Path(text).name.lower()
    if text.lower().startswith(_URL_PREFIXES) or name.endswith(".3tz"):
        return True
    if name.endswith(".json"):
        return name not in codec_named("sog").suffixes and _may_be_tileset(text)
    return (Path(text) / INDEX_FILE).is_file()


def names_tileset_or_content(path: Path) -> bool:
    """Return whether `gsgen validate` checks ``path`` by the rules of tilesets."""
    return path.suffix.lower() in (*_CONTENT_SUFFIXES, ".json") or names_tileset(path)


def _may_be_tileset(path: str) -> bool:
    try:
        kind = kind_of_file(path)
    except OSError:  # opening it as a tileset reports the cause
        return True
    return kind is None or kind.name in ("tileset", "json")
