"""Zstandard, which Python before 3.14 lacks: through the package ``zstandard``, if it is there."""

from typing import Any

from gsgen.formats.shared.bytes import AGAIN
from gsgen.formats.shared.errors import ArchiveDamaged, NotSupported

_CHUNK = 1 << 20
_MOST_WINDOW = 1 << 27


def _package() -> Any:
    try:
        import zstandard
    except ImportError as error:
        raise NotSupported(
            "zstd, for which the package zstandard is not installed",
            hint="pip install 'gsgen[formats]'",
        ) from error
    return zstandard


def unpack(data: bytes, size: int, where: str) -> bytearray:
    """Return the ``size`` bytes that ``data`` unpacks to; no more are ever held.

    Raises:
        ArchiveDamaged: It cannot be unpacked, or to another size.
        NotSupported: The package is missing.
    """
    zstandard = _package()
    made = bytearray()
    try:
        unpacker = zstandard.ZstdDecompressor(max_window_size=_MOST_WINDOW)
        with unpacker.stream_reader(data, read_across_frames=False) as reader:
            while len(made) <= size:
                piece = reader.read(min(_CHUNK, size + 1 - len(made)))
                if not piece:
                    break
                made += piece
    except zstandard.ZstdError as error:
        raise ArchiveDamaged(
            f"cannot be unpacked ({error})", where=where, hint=AGAIN
        ) from error
    if len(made) != size:
        seen = f"more than {size}" if len(made) > size else f"{len(made)}"
        raise ArchiveDamaged(
            f"unpacks to {seen} bytes", where=where, expected=f"{size}", hint=AGAIN
        )
    return made


def pack(data: bytes) -> bytes:
    """Return ``data`` compressed, with its size and a checksum.

    Raises:
        NotSupported: The package is missing.
    """
    return bytes(_package().ZstdCompressor(level=12).compress(data))
