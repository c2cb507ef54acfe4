"""Writes .3tz archives: members stored uncompressed, and an index as the last member."""

__all__ = ["write_archive"]

import zipfile
from pathlib import Path

from gsgen.formats.shared.files import replacing
from gsgen.tiles.stores.zip_store import INDEX_NAME, index_record, index_sort_key

_DATE = (1980, 1, 1, 0, 0, 0)  # the first of a zip file: equal folders give equal archives


def write_archive(folder: Path, archive: Path) -> int:
    """Pack the files of ``folder`` into a .3tz archive; return their number.

    Hidden files and those whose names end in ``.tmp`` are left out.
    """
    paths = sorted(
        file.relative_to(folder).as_posix()
        for file in folder.rglob("*")
        if file.is_file() and not file.name.startswith(".") and file.suffix != ".tmp"
    )
    paths = [path for path in paths if (folder / path).resolve() != archive.resolve()]
    records: list[bytes] = []
    with replacing(archive) as stream, zipfile.ZipFile(stream, "w") as packed:
        for path in paths:
            offset = stream.tell()
            packed.writestr(_entry(path), (folder / path).read_bytes())
            records.append(index_record(path, offset))
        records.sort(key=lambda record: index_sort_key(record[:16]))
        packed.writestr(_entry(INDEX_NAME), b"".join(records))
    return len(paths)


def _entry(path: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(path, _DATE)
    entry.external_attr = 0o644 << 16
    return entry
