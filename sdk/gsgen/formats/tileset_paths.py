"""Recognises paths and addresses of tilesets (3D Tiles): by names, JSON files by their content."""

__all__ = ["INDEX_FILE", "names_stream", "names_tileset", "names_tileset_or_content"]

import os
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Final
from urllib.parse import urlsplit

from gsgen.contract.file_kinds.names import STREAMED_META
from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES, kind_of, kind_of_file
from gsgen.formats.codecs import codec_named

INDEX_FILE: Final = "tileset.json"
"""The file in a tileset's folder that lists its tiles."""

_STREAMED_SCHEMES: Final = ("http", "https")
_ARCHIVE_SUFFIX: Final = ".3tz"
_CONTENT_SUFFIXES: Final = (".glb", ".gltf")


def names_tileset(path: str | os.PathLike[str]) -> bool:
    """Return whether a path or address names a tileset: an archive, JSON, or a folder.

    A JSON file is one unless its content is known to be something else. Of an address without a
    suffix, and of one of JSON, the first bytes are fetched.

    Raises:
        InputUnreadable: An address cannot be read.
    """
    text = os.fspath(path)
    if ":/" in text:
        from gsgen.contract.inputs.addresses import address_of

        address = address_of(text)
        if address:
            return _is_tileset_address(address)
    name = Path(text).name.lower()
    if name.endswith(_ARCHIVE_SUFFIX):
        return True
    if name.endswith(".json"):
        return name not in codec_named("sog").suffixes and _may_be_tileset(text)
    return (Path(text) / INDEX_FILE).is_file()


def names_stream(path: str | os.PathLike[str]) -> bool:
    """Return whether frames stream a path or address: a tileset, or the JSON of a streamed SOG."""
    name = urlsplit(os.fspath(path)).path.rpartition("/")[2].lower()
    return name == STREAMED_META or names_tileset(path)


def names_tileset_or_content(path: Path) -> bool:
    """Return whether `gsgen validate` checks ``path`` by the rules of tilesets."""
    return path.suffix.lower() in (*_CONTENT_SUFFIXES, ".json") or names_tileset(path)


@cache
def _is_tileset_address(address: str) -> bool:
    """Return whether a web address is that of a tileset, by its name, or by its first bytes."""
    try:
        parts = urlsplit(address)
    except ValueError:  # fetching it reports the fault
        return False
    if parts.scheme not in _STREAMED_SCHEMES:
        return False
    name = parts.path.rpartition("/")[2].lower()
    suffix = PurePosixPath(name).suffix
    if name in ("", INDEX_FILE) or suffix == _ARCHIVE_SUFFIX:
        return True
    if suffix not in ("", ".json"):
        return False
    from gsgen.contract.inputs.local_copies import read_start

    kind = kind_of(read_start(address, RECOGNITION_BYTES))
    tileset_kinds = ("tileset", "json") if suffix else ("tileset",)
    return (kind is None and bool(suffix)) or (kind is not None and kind.name in tileset_kinds)


def _may_be_tileset(path: str) -> bool:
    try:
        kind = kind_of_file(path)
    except OSError:  # opening it as a tileset reports the cause
        return True
    return kind is None or kind.name in ("tileset", "json")
