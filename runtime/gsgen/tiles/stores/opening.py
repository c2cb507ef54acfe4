"""Opens the file store of a tileset from a path or an address."""

__all__ = ["TILESET_KINDS", "address_of", "open_store"]

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

from gsgen.contract.file_kinds.recognition import kind_of_file
from gsgen.contract.inputs.addresses import address_of as input_address
from gsgen.formats.tileset_paths import INDEX_FILE
from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.stores.folder_store import FolderStore
from gsgen.tiles.stores.http_store import HttpStore
from gsgen.tiles.stores.ranged_file import RangedFile
from gsgen.tiles.stores.store import Store
from gsgen.tiles.stores.zip_store import ZipStore

TILESET_KINDS: Final = ("tileset", "json")
"""Kinds of files that list the tiles of a tileset: known ones, and JSON that nothing else claims."""


def open_store(
    source: str | Path,
    *,
    allow_origins: Sequence[str] = (),
    kinds: Collection[str] = (*TILESET_KINDS, "streamed-sog"),
) -> tuple[Store, str]:
    """Return the file store of a tileset, and the path of ``tileset.json`` in the store.

    Args:
        source: ``tileset.json``, the folder that holds one, a ``.3tz`` archive, or an address
            (http, https) of a ``tileset.json`` or a ``.3tz`` archive.
        allow_origins: Other origins that redirects of a server may lead to.
        kinds: Names of the kinds of files that it may be.

    Raises:
        TilesetInvalid: The file is of another kind, which the error names.
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
    kind = kind_of_file(path) if path.is_file() else None
    if kind is not None and kind.name not in kinds:
        raise TilesetInvalid(
            f"this is {kind.title}", location=str(path), expected="a tileset", hint=kind.hint
        )
    return FolderStore(path.parent), path.name


def address_of(source: str | Path) -> str:
    """Return the http or https address that a text or path stands for; empty for other paths."""
    address = input_address(source)
    return address if address.startswith(("http://", "https://")) else ""
