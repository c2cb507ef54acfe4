"""Opens the file store of a tileset from a path or an address."""

__all__ = ["address_of", "open_store"]

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote, urlsplit

from gsgen.formats.tileset_paths import INDEX_FILE
from gsgen.tiles.stores.folder_store import FolderStore
from gsgen.tiles.stores.http_store import HttpStore
from gsgen.tiles.stores.ranged_file import RangedFile
from gsgen.tiles.stores.store import Store
from gsgen.tiles.stores.zip_store import ZipStore


def open_store(source: str | Path, *, allow_origins: Sequence[str] = ()) -> tuple[Store, str]:
    """Return the file store of a tileset, and the path of ``tileset.json`` in the store.

    Args:
        source: ``tileset.json``, the folder that holds one, a ``.3tz`` archive, or an address
            (http, https) of a ``tileset.json`` or a ``.3tz`` archive.
        allow_origins: Other origins that redirects of a server may lead to.
    """
    address = address_of(source)
    if address:
        store = HttpStore(address, allow_origins=allow_origins)
        name = unquote(urlsplit(address).path.rpartition("/")[2])
        if name.lower().endswith(".3tz"):
            return ZipStore(RangedFile(store, name), address), INDEX_FILE
        return store, name or INDEX_FILE
    path = Path(source)
    if path.suffix.lower() == ".3tz":
        return ZipStore(path), INDEX_FILE
    if path.is_dir():
        return FolderStore(path), INDEX_FILE
    return FolderStore(path.parent), path.name


def address_of(source: str | Path) -> str:
    """Return a URL with ``://``, which ``Path`` shortened to ``:/``; empty for a local path."""
    text = str(source)
    for scheme in ("http", "https"):
        if text.lower().startswith(f"{scheme}:/"):
            return f"{scheme}://{text[len(scheme) + 1 :].lstrip('/')}"
    return ""
