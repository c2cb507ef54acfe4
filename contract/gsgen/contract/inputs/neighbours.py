"""The files beside it that a file of JSON names: textures of a SOG, buffers of a glTF file."""

__all__ = ["named_neighbours", "require_whole"]

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote

from gsgen.contract.errors import InputUnreadable
from gsgen.contract.file_kinds.kind import FileKind

_SOG_KINDS: Final = ("sog",)
_GLTF_KINDS: Final = ("gltf", "gltf-splats")
_FOLDER_KINDS: Final = {
    "streamed-sog": "the files of a streamed SOG",
    "scene": "the files of a scene",
}
_STREAMED_ADDRESSES: Final = ("https://", "http://")
_MAX_JSON_BYTES: Final = 64 << 20


def named_neighbours(path: Path, kind: FileKind) -> list[str]:
    """Return the relative paths that a SOG's or glTF file's JSON names; others name none."""
    if kind.name not in (*_SOG_KINDS, *_GLTF_KINDS) or path.stat().st_size > _MAX_JSON_BYTES:
        return []
    try:
        document = json.loads(path.read_bytes())
    except (ValueError, RecursionError):  # a ZIP archive of a SOG, or damaged: its reader says so
        return []
    key = "files" if kind.name in _SOG_KINDS else "uri"
    names = (name for name in _values_of(document, key) if not name.startswith("data:"))
    return list(dict.fromkeys(names if key == "files" else map(unquote, names)))


def _values_of(document: Any, key: str) -> Iterator[str]:
    """Yield the texts below a key, wherever it is in a JSON document."""
    pending = [document]
    while pending:
        item = pending.pop()
        if isinstance(item, list):
            pending += item
        elif isinstance(item, dict):
            value = item.get(key)
            yield from (text for text in _listed(value) if isinstance(text, str))
            pending += item.values()


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def require_whole(address: str, kind: FileKind) -> None:
    """Raise for a file whose parts are in folders that no address lists.

    A tileset of a web server is no such file to commands that stream it; others say what it is.
    """
    if kind.name == "tileset" and not address.startswith(_STREAMED_ADDRESSES):
        raise InputUnreadable(
            f"this is {kind.title}, which is streamed from https and http alone",
            where=address,
            hint="Name its https address, or download its folder.",
        )
    parts = _FOLDER_KINDS.get(kind.name)
    if parts is not None:
        raise InputUnreadable(
            f"this is {kind.title}, and {parts} are not fetched from addresses",
            where=address,
            hint="Download its folder, and name the file there.",
        )
