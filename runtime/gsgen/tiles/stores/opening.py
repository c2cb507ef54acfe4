"""Opens the file store of a tileset from a path or an address."""

__all__ = ["address_of", "open_store"]

from collections.abc import Sequence
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

_TILESET_KINDS: Final = ("tileset", "json")
_STREAMED_KINDS: Final = ("streamed-sog",)
_CONTENT_KINDS: Final = ("glb", "glb-splats", "gltf", "gltf-splats")


def open_store(
    source: str | Path,
    *,
    allow_origins: Sequence[str] = (),
    allow_content: bool = False,
    allow_streamed: bool = True,
) -> tuple[Store, str]:
    """Return the file store of a tileset, and the path of ``tileset.json`` in the store.

    Args:
        source: ``tileset.json``, the folder that holds one, a ``.3tz`` archive, or an address
            (http, https) of a ``tileset.json`` or a ``.3tz`` archive.
        allow_origins: Other origins that redirects of a server may lead to.
        allow_content: Whether a file may be the content of a tile.
        allow_streamed: Whether it may be the ``lod-meta.json`` of a streamed SOG.

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
    if path.is_file():
        _refuse_other_kind(path, allow_content=allow_content, allow_streamed=allow_streamed)
    return FolderStore(path.parent), path.name


def _refuse_other_kind(path: Path, *, allow_content: bool, allow_streamed: bool) -> None:
    kind = kind_of_file(path)
    known_names = (
        *_TILESET_KINDS,
        *(_CONTENT_KINDS if allow_content else ()),
        *(_STREAMED_KINDS if allow_streamed else ()),
    )
    if kind is not None and kind.name not in known_names:
        raise TilesetInvalid(
            f"this is {kind.title}", location=str(path), expected="a tileset", hint=kind.hint
        )


def address_of(source: str | Path) -> str:
    """Return the http or https address that a text or path stands for; empty for other paths."""
    address = input_address(source)
    return address if address.startswith(("http://", "https://")) else ""
