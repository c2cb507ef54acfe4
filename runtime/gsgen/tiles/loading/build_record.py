"""Reads ``gsgen.tiles.json``, the build record with the size and digest of every file."""

__all__ = ["BuildRecord", "RecordedFile", "read_build_record"]

import posixpath
import re
from dataclasses import dataclass
from typing import final

from gsgen.tiles.errors import ContentMissing, Fault
from gsgen.tiles.format.index import BUILD_RECORD
from gsgen.tiles.format.json_values import MAX_JSON, parse_object
from gsgen.tiles.format.uris import resolve_uri
from gsgen.tiles.stores.store import Store

_DIGEST_PATTERN = re.compile(r"^[0-9a-f]{64}$")


@final
@dataclass(frozen=True, slots=True)
class RecordedFile:
    """The size and SHA-256 of a tileset's file when it was written."""

    size: int
    sha256: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BuildRecord:
    """The record of a tileset build: its inputs, and the size and digest of every file.

    Attributes:
        location: The file.
        key: Digest of the inputs and parameters.
        source_splats: How many splats went in.
        files: Path → the file as it was written.
    """

    location: str
    key: str
    source_splats: int
    files: dict[str, RecordedFile]


def read_build_record(store: Store, index: str) -> BuildRecord | None:
    """Return the build record beside a tileset's ``tileset.json``; None if it is missing.

    Raises:
        TilesetInvalid: The record is not valid JSON, or a member is wrong.
    """
    path = posixpath.join(posixpath.dirname(index), BUILD_RECORD)
    try:
        data = store.read(path, limit=MAX_JSON)
    except ContentMissing:
        return None
    document = parse_object(data, f"{path}, ", fault=Fault.SCHEMA)
    files = document.child("files")
    recorded_files = {}
    for uri in files.values:
        entry = files.child(uri)
        digest = entry.text("sha256")
        if not _DIGEST_PATTERN.match(digest):
            entry.refuse("sha256", "64 hexadecimal digits")
        name = resolve_uri(index, uri, files.at(uri))
        recorded_files[name] = RecordedFile(entry.whole("bytes"), digest)
    return BuildRecord(
        location=path,
        key=document.text("key"),
        source_splats=document.whole("source_splats"),
        files=recorded_files,
    )
