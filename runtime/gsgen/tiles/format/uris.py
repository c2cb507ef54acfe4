"""Resolves the URIs in a tileset to paths of files within the tileset's folder.

Generic syntax: RFC 3986. A tileset refers to files below its own folder only; anything else
is refused, so that a downloaded file cannot make a reader open another one.
"""

__all__ = ["DIGEST_IN_PATH", "is_external", "resolve_uri"]

import posixpath
import re
from urllib.parse import unquote

from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.json_values import shorten

DIGEST_IN_PATH = re.compile(r"-([0-9a-f]{8})(?:\.glb|\.webp|/meta\.json)$")
"""The first digits of a file's SHA-256 in its path: a file of such a path never changes."""

_URI_SCHEME_PATTERN = re.compile(r"^[A-Za-z][A-Za-z0-9+.-]*:")
_MAX_URI_LENGTH = 2048


def resolve_uri(base: str, uri: str, location: str) -> str:
    """Resolve a URI in one of a tileset's files to a path relative to the tileset's folder.

    Args:
        base: The path of the file that holds the uri, relative to the tileset's folder.
        uri: The uri as written; a query is dropped.
        location: Where it stands, for the error.

    Raises:
        TilesetInvalid: It leaves the folder, or names another server or a scheme.
    """
    path = unquote(re.split(r"[?#]", uri, maxsplit=1)[0])
    resolved = posixpath.normpath(posixpath.join(posixpath.dirname(base), path))
    outside = (
        bool(_URI_SCHEME_PATTERN.match(uri))
        or path.startswith(("/", "\\"))
        or resolved == ".."
        or resolved.startswith("../")
        or "\\" in path
        or "\0" in path
        or not path
        or resolved == "."
        or len(uri) > _MAX_URI_LENGTH
    )
    if outside:
        raise TilesetInvalid(
            shorten(uri),
            location=location,
            expected="a relative uri of a file within the folder of the tileset",
            hint="Move the file below the folder of tileset.json, and refer to it from there.",
            fault=Fault.URI,
        )
    return resolved


def is_external(uri: str) -> bool:
    """Return whether a content's URI names an external tileset."""
    return re.split(r"[?#]", uri, maxsplit=1)[0].lower().endswith(".json")
