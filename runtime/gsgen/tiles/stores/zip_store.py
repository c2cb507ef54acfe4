"""Reads and writes .3tz archives of tilesets: zip files whose last member indexes paths by MD5.

The format is 3D Tiles Archive 1.3 (Maxar): members are stored as they are or deflated; the
member ``@3dtilesIndex1@`` holds records of 24 bytes (MD5 of the path, offset of the member's
local header), sorted by the digest as two little-endian 64-bit numbers.
"""

__all__ = ["INDEX_NAME", "ZipStore", "index_record", "index_sort_key", "write_archive"]

import errno
import hashlib
import struct
import zipfile
import zlib
from pathlib import Path
from threading import Lock
from typing import BinaryIO, Final, cast, final

from gsgen.formats.shared.files import replace_file
from gsgen.tiles.errors import Fault, StoreUnavailable, TilesetInvalid
from gsgen.tiles.stores.ranged_file import RangedFile
from gsgen.tiles.stores.store import MAX_STORE_FILE_BYTES, Store, check_range, missing, too_large

INDEX_NAME: Final = "@3dtilesIndex1@"
_INDEX_RECORD = struct.Struct("<16sQ")
_LOCAL_HEADER = struct.Struct("<4s5H3I2H")
_LOCAL_MAGIC = b"PK\x03\x04"
_DEFLATE_METHOD = 8
_MAX_MEMBERS = 4_000_000
_ARCHIVE_DATE = (1980, 1, 1, 0, 0, 0)  # the first of a zip file: equal folders give equal archives


def index_sort_key(digest: bytes) -> tuple[int, int]:
    """Return the sort key of a record in the index of a .3tz archive."""
    low, high = struct.unpack("<QQ", digest)
    return low, high


def index_record(path: str, offset: int) -> bytes:
    """Return the record of a member in the index of a .3tz archive."""
    digest = hashlib.md5(path.encode(), usedforsecurity=False).digest()
    return _INDEX_RECORD.pack(digest, offset)


@final
class ZipStore(Store):
    """Reads single files of a .3tz archive, which is a local file or one of a web server."""

    def __init__(self, archive: Path | RangedFile, name: str = "") -> None:
        self.name = name or str(archive)
        self._lock = Lock()
        try:
            self._file = archive if isinstance(archive, RangedFile) else _open_archive(archive)
        except OSError as error:
            raise StoreUnavailable(
                f"the archive cannot be read: {error.strerror}",
                location=self.name,
                expected="a .3tz archive",
                fault=Fault.CONTENT,
            ) from error
        try:
            self._members = self._list_members()
        except BaseException:
            self._file.close()
            raise

    def _list_members(self) -> dict[str, zipfile.ZipInfo]:
        try:
            with zipfile.ZipFile(cast(BinaryIO, self._file)) as archive:
                members = archive.infolist()
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
            raise self._damage_error(f"the zip archive cannot be listed ({error})") from error
        if len(members) > _MAX_MEMBERS:
            raise self._damage_error(
                f"the archive has {len(members):,} files, over {_MAX_MEMBERS:,}"
            )
        by_name = {member.filename: member for member in members}
        index = by_name.get(INDEX_NAME)
        if index is not None:
            self._check_index(index, by_name)
        return by_name

    def _check_index(self, index: zipfile.ZipInfo, by_name: dict[str, zipfile.ZipInfo]) -> None:
        """Raise if the index of a .3tz archive and its zip directory disagree on offsets."""
        members = [member for name, member in by_name.items() if name != INDEX_NAME]
        if index.file_size != _INDEX_RECORD.size * len(members):
            raise self._damage_error(
                f"the index of the archive has {index.file_size} bytes, but {len(members)} files "
                f"need {_INDEX_RECORD.size * len(members)}"
            )
        expected = {index_record(m.filename, m.header_offset) for m in members}
        data = self._read_member(index, 0, index.file_size)
        records = [data[offset : offset + 24] for offset in range(0, len(data), _INDEX_RECORD.size)]
        if set(records) != expected:
            raise self._damage_error("the index does not list the files of the archive")

    def size(self, path: str) -> int:
        """Return the unpacked size of an archive member in bytes."""
        return self._member_info(path).file_size

    def read(
        self,
        path: str,
        *,
        start: int = 0,
        size: int | None = None,
        limit: int = MAX_STORE_FILE_BYTES,
    ) -> bytes:
        """Read bytes of an archive member, see :class:`~gsgen.tiles.stores.store.Store`."""
        member = self._member_info(path)
        count = check_range(self.name, path, member.file_size, start, size, limit)
        if member.compress_type != zipfile.ZIP_STORED and start + count > limit:
            raise too_large(self.name, path, start + count, limit)
        return self._read_member(member, start, count)

    def _member_info(self, path: str) -> zipfile.ZipInfo:
        member = self._members.get(path)
        if member is None or member.is_dir():
            raise missing(self.name, path, "the archive has no such member")
        return member

    def _read_member(self, member: zipfile.ZipInfo, start: int, count: int) -> bytes:
        """Read an archive member by its local header; offsets in the zip directory may be wrong."""
        header = self._read_range(member.header_offset, _LOCAL_HEADER.size)
        if len(header) < _LOCAL_HEADER.size or header[:4] != _LOCAL_MAGIC:
            raise self._damage_error(f"{member.filename} is not at byte {member.header_offset}")
        *_, name_length, extra_length = _LOCAL_HEADER.unpack(header)
        first = member.header_offset + _LOCAL_HEADER.size + name_length + extra_length
        if member.flag_bits & 1:
            raise self._damage_error(f"{member.filename} is encrypted")
        if member.compress_type == zipfile.ZIP_STORED:
            data = self._read_range(first + start, count)
        elif member.compress_type == _DEFLATE_METHOD:
            data = self._inflate_member(first, member.compress_size, start + count)[start:]
        else:
            method = member.compress_type
            raise self._damage_error(
                f"{member.filename} has compression method {method}, not 0 (stored) or 8 (deflate)"
            )
        if len(data) < count:
            raise self._damage_error(f"{member.filename} is truncated")
        is_whole_member = start == 0 and count == member.file_size
        if is_whole_member and zlib.crc32(data) != member.CRC:
            raise self._damage_error(f"{member.filename} has other bytes than its CRC-32 tells")
        return data

    def _inflate_member(self, first: int, packed: int, count: int) -> bytes:
        decompressor = zlib.decompressobj(wbits=-15)
        data = self._read_range(first, min(packed, count + (count >> 3) + (1 << 16)))
        try:
            return decompressor.decompress(data, count) if count else b""
        except zlib.error as error:
            raise self._damage_error(f"an archived file cannot be unpacked ({error})") from error

    def _read_range(self, start: int, count: int) -> bytes:
        if isinstance(self._file, RangedFile):
            return self._file.read_at(start, count)
        with self._lock:
            try:
                self._file.seek(start)
                return self._file.read(count)
            except (OSError, ValueError, OverflowError) as error:
                raise self._damage_error(f"the archive cannot be read ({error})") from error

    def _damage_error(self, actual: str) -> TilesetInvalid:
        return TilesetInvalid(
            actual,
            location=self.name,
            expected="a .3tz archive: members stored or deflated, and an index of them",
            hint="Copy or download the archive again.",
            fault=Fault.CONTENT,
        )

    def close(self) -> None:
        """Close the .3tz archive."""
        self._file.close()


def _open_archive(archive: Path) -> BinaryIO:
    if archive.exists() and not archive.is_file():  # opening a pipe waits for its writer
        raise OSError(errno.EINVAL, "the path is a folder, device, pipe or socket")
    return archive.open("rb")


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
    with replace_file(archive) as stream, zipfile.ZipFile(stream, "w") as packed:
        for path in paths:
            offset = stream.tell()
            packed.writestr(_zip_entry(path), (folder / path).read_bytes())
            records.append(index_record(path, offset))
        records.sort(key=lambda record: index_sort_key(record[:16]))
        packed.writestr(_zip_entry(INDEX_NAME), b"".join(records))
    return len(paths)


def _zip_entry(path: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(path, _ARCHIVE_DATE)
    entry.external_attr = 0o644 << 16
    return entry
