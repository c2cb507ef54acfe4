"""Reads a splat file on a web server, with the files that the splat file names."""

__all__ = ["names_one_file", "read_download"]

import os
import posixpath
import re
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

from gsgen.contract.process.drafts import temporary_folder
from gsgen.formats import FormatError, codec_of_suffix, open_splats
from gsgen.formats.shared.errors import HeaderMalformed, quoted
from gsgen.formats.shared.splats import PackedRows, PointCloud, Splats
from gsgen.formats.sog.meta import META_FILE, Meta
from gsgen.tiles.stores.http_store import HttpStore

MAX_DOWNLOAD: Final = 8 << 30
"""The most bytes of a file that are downloaded."""
_FILE_NAME: Final = re.compile(r"[^/\\\x00-\x1f\ud800-\udfff]{1,200}")


def names_one_file(source: str | os.PathLike[str]) -> bool:
    """Return whether a text is a web address with the suffix of a splat file."""
    try:
        parts = urlsplit(_url_of_source(source))
    except ValueError:
        return False  # opening the address says why
    return parts.scheme in ("http", "https") and codec_of_suffix(parts.path) is not None


def read_download(source: str | os.PathLike[str]) -> Splats | PointCloud | PackedRows:
    """Download a file of splats to a temporary folder, and read it.

    Raises:
        FormatError: The file cannot be read; its path is the address.
        ContentMissing: The server has no such file.
        StoreUnavailable: The server cannot be reached now.
    """
    address = _url_of_source(source)
    name = unquote(posixpath.basename(urlsplit(address).path))
    with temporary_folder() as folder, HttpStore(address) as store:

        def fetch(name: str) -> Path:
            file = folder / posixpath.basename(name)
            with file.open("wb") as stream:
                store.for_large_file().save(name, stream, limit=MAX_DOWNLOAD)
            return file

        try:
            file = fetch(name)
            if name.lower() == META_FILE:
                for image in Meta.parse(file.read_bytes()).all_files():
                    if not _FILE_NAME.fullmatch(image) or image in (".", ".."):
                        raise HeaderMalformed(
                            quoted(image),
                            where=META_FILE,
                            expected="the name of an image beside it",
                        )
                    fetch(image)
            return open_splats(file)
        except FormatError as error:
            error.path = address
            raise


def _url_of_source(source: str | os.PathLike[str]) -> str:
    """Restore the second slash after the scheme of a web address, which ``Path`` removed."""
    return re.sub(r"^(https?):/+", r"\1://", os.fspath(source), flags=re.IGNORECASE)
