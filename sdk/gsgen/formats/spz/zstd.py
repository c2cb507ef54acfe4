"""Packs and unpacks zstd data with the package ``zstandard``, since older Python lacks zstd."""

from typing import Any

from gsgen.formats.shared.bytes import DOWNLOAD_HINT
from gsgen.formats.shared.errors import ArchiveDamaged, NotSupported

_CHUNK_BYTES = 1 << 20
_MAX_WINDOW_BYTES = 1 << 27


def _zstd_package() -> Any:
    try:
        import zstandard
    except ImportError as error:
        raise NotSupported(
            "the file is packed with zstd, and the package zstandard is not installed",
            hint="pip install 'gsgen[formats]'",
        ) from error
    return zstandard


def unpack(data: bytes, size: int, where: str) -> bytearray:
    """Unpack zstd data to ``size`` bytes, within a memory limit."""
    zstandard = _zstd_package()
    content = bytearray()
    try:
        unpacker = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
        with unpacker.stream_reader(data, read_across_frames=False) as reader:
            while len(content) <= size:
                piece = reader.read(min(_CHUNK_BYTES, size + 1 - len(content)))
                if not piece:
                    break
                content += piece
    except zstandard.ZstdError as error:
        raise ArchiveDamaged(
            f"the zstd stream cannot be unpacked ({error})", where=where, hint=DOWNLOAD_HINT
        ) from error
    if len(content) != size:
        actual_size = f"more than {size}" if len(content) > size else f"{len(content)}"
        raise ArchiveDamaged(
            f"the zstd stream unpacks to {actual_size} bytes",
            where=where,
            expected=f"{size}",
            hint=DOWNLOAD_HINT,
        )
    return content


def pack(data: bytes) -> bytes:
    """Return ``data`` compressed as a zstd frame, with its size and a checksum."""
    return bytes(_zstd_package().ZstdCompressor(level=12).compress(data))
