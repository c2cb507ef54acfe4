"""Packs and unpacks SPZ files: the header, and attribute streams in gzip or zstd.

The format is that of nianticlabs/spz. The count of the header limits the unpacked bytes, and the
size of the file limits the count.
"""

import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from jaxtyping import UInt8

from gsgen.formats.shared.axes import RDF_RUB, AxisSigns
from gsgen.formats.shared.bytes import (
    DOWNLOAD_HINT,
    MAX_SPLATS,
    Data,
    not_recognised,
    read_array,
    require_length,
)
from gsgen.formats.shared.errors import (
    ArchiveDamaged,
    FileTruncated,
    HeaderMalformed,
    NotSupported,
    SizeExceeded,
    ValueInvalid,
)
from gsgen.formats.spz import zstd
from gsgen.formats.spz.streams import STREAM_NAMES, sizes

MAGIC: Final = b"NGSP"
GZIP: Final = b"\x1f\x8b"
NEWEST_GZIP_VERSION, NEWEST_VERSION = 3, 4
"""The last version in gzip, and the last version."""

_ANTIALIASED_FLAG, _EXTENDED_FLAG = 1, 2
_FILE_HEADER, _FILE_HEADER_WITH_TABLE = struct.Struct("<4sIIBBBB"), struct.Struct("<4sIIBBBBI12s")
_TOC_ENTRY = struct.Struct("<QQ")
_RECORD_HEADER_STRUCT = struct.Struct("<II")
_MAX_SPLATS_PER_NINE_BYTES = 1024

_MAX_SH_DEGREE, _MAX_FRACTIONAL_BITS = 4, 24
_MAX_EXTENSIONS = 1 << 20
_CHUNK_BYTES = 1 << 20
_CAMERA_EXTENSION, _COORDINATES_EXTENSION = 0xADBE0002, 0xADBE0003

Streams = dict[str, UInt8[np.ndarray, " b"]]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """The header fields of an SPZ file, and its unpacked attribute streams.

    Attributes:
        signs: The factors between the axes of the file and those of a PLY file.
        unused: The declared parts that no version of the format defines.
    """

    version: int
    count: int
    degree: int
    fractional_bits: int
    antialiased: bool
    streams: Streams
    signs: AxisSigns = RDF_RUB
    unused: tuple[str, ...] = ()


def is_packed(head: bytes) -> bool:
    """Return whether a file begins as a gzip file of an SPZ file of version 1 to 3."""
    if not head.startswith(GZIP):
        return False
    try:
        content = zlib.decompressobj(wbits=31).decompress(head, _FILE_HEADER.size)
    except zlib.error:
        return False
    # Version 4 has no gzip stream; a gzip file of it was packed by someone else.
    return content[:4] == MAGIC and int.from_bytes(content[4:8], "little") <= NEWEST_GZIP_VERSION


def unpack(data: Data, max_bytes: int) -> Frame:
    """Unpack the header and the attribute streams of the SPZ file ``data``.

    Raises:
        FormatNotRecognised: The data are not an SPZ file.
        NotSupported: The version is later than 4, or the axes are swapped.
        HeaderMalformed: The header contradicts itself or the size of the file.
        FileTruncated: The data ends early.
        ArchiveDamaged: The data cannot be unpacked.
        SizeExceeded: The attributes need more than ``max_bytes``.
    """
    if data[:2] == GZIP:
        return _unpack_gzip(data, max_bytes)
    require_length(data, 0, _FILE_HEADER.size, "header")
    version = _FILE_HEADER.unpack_from(data)[1]
    if (
        data[:4] == MAGIC and version <= NEWEST_GZIP_VERSION
    ):  # the content of the gzip stream, not compressed
        return _unpack_uncompressed(iter([bytes(data)]), len(data), max_bytes)
    return _unpack_zstd(data, max_bytes)


def _unpack_gzip(data: Data, max_bytes: int) -> Frame:
    ends: list[int] = []
    frame = _unpack_uncompressed(_inflated_chunks(data, ends), len(data), max_bytes)
    trailing_bytes = len(data) - ends[0] if ends else 0
    if not trailing_bytes:
        return frame
    text = f"{trailing_bytes:,} bytes after the end of the gzip stream"
    return replace(frame, unused=(*frame.unused, text))


def _inflated_chunks(data: Data, ends: list[int]) -> Iterator[bytes]:
    """Yield the unpacked bytes of a gzip file, piece by piece; append the byte where it ends."""
    unpacker = zlib.decompressobj(wbits=31)
    try:
        for start in range(0, len(data), _CHUNK_BYTES):
            if unpacker.eof:
                break
            piece = data[start : start + _CHUNK_BYTES]
            output = b"more"
            while not unpacker.eof and (piece or output):
                output = unpacker.decompress(piece, _CHUNK_BYTES)
                piece = unpacker.unconsumed_tail
                yield output
            if unpacker.eof:
                read_bytes = min(start + _CHUNK_BYTES, len(data))
                ends.append(read_bytes - len(unpacker.unused_data))
    except zlib.error as error:
        raise ArchiveDamaged(
            f"the gzip stream cannot be unpacked ({error})", where="gzip stream", hint=DOWNLOAD_HINT
        ) from error
    if not unpacker.eof:
        raise FileTruncated(
            f"the gzip stream does not end within {len(data)} bytes",
            where="gzip stream",
            hint=DOWNLOAD_HINT,
        )


def _unpack_uncompressed(pieces: Iterator[bytes], size: int, max_bytes: int) -> Frame:
    """Parse the header and attributes of SPZ versions 1 to 3 from unpacked gzip data."""
    body = bytearray()
    _append_chunks(body, pieces, _FILE_HEADER.size)
    require_length(body, 0, _FILE_HEADER.size, "header, unpacked")
    magic, version, count, degree, fraction, flags, reserved = _FILE_HEADER.unpack_from(body)
    if version > NEWEST_GZIP_VERSION:
        raise HeaderMalformed(
            f"the gzip file has SPZ version {version}", where="byte 4", expected="1, 2 or 3"
        )
    _require_magic(magic, body)
    _require_header(version, count, degree, fraction, size)
    parts = sizes(version, count, degree)
    end = _FILE_HEADER.size + sum(parts.values())
    _require_memory(end, max_bytes)
    # One more byte than needed, which reveals excess data.
    _append_chunks(body, pieces, end + (_MAX_EXTENSIONS if flags & _EXTENDED_FLAG else 1))
    require_length(body, _FILE_HEADER.size, end - _FILE_HEADER.size, f"{count} splats, unpacked")
    trailing_bytes = body[end:]
    if trailing_bytes and not flags & _EXTENDED_FLAG:
        raise HeaderMalformed(
            f"the file has more than the {end} bytes of {count} splats of degree {degree}",
            where="unpacked data",
            expected=f"{end} bytes",
            hint=DOWNLOAD_HINT,
        )
    signs, unknown_extensions = _read_extensions(
        bytes(trailing_bytes) if flags & _EXTENDED_FLAG else b""
    )
    streams, offset = {}, _FILE_HEADER.size
    for name, length in parts.items():
        streams[name] = read_array(body, np.uint8, (length,), offset, name)
        offset += length
    is_antialiased = bool(flags & _ANTIALIASED_FLAG)
    return Frame(
        version=version,
        count=count,
        degree=degree,
        fractional_bits=fraction,
        antialiased=is_antialiased,
        streams=streams,
        signs=signs,
        unused=(*_undefined_header(flags, bytes([reserved])), *unknown_extensions),
    )


def _append_chunks(body: bytearray, pieces: Iterator[bytes], length: int) -> None:
    for piece in pieces if len(body) < length else ():
        body += piece
        if len(body) >= length:
            return


def _unpack_zstd(data: Data, max_bytes: int) -> Frame:
    require_length(data, 0, _FILE_HEADER_WITH_TABLE.size, "header")
    fields = _FILE_HEADER_WITH_TABLE.unpack_from(data)
    magic, version, count, degree, fraction, flags, stream_count, toc, reserved = fields
    _require_magic(magic, data)
    _require_header(version, count, degree, fraction, len(data))
    parts = {name: size for name, size in sizes(version, count, degree).items() if size}
    _require_memory(sum(parts.values()), max_bytes)
    if stream_count != len(parts):
        raise HeaderMalformed(
            f"the SPZ file has {stream_count} attribute streams",
            where="byte 15",
            expected=f"{len(parts)}, one for each attribute",
        )
    if toc < _FILE_HEADER_WITH_TABLE.size:
        raise HeaderMalformed(
            f"the table of contents is at byte {toc}", where="byte 16", expected="byte 32 or more"
        )
    require_length(data, toc, stream_count * _TOC_ENTRY.size, "table of contents")
    between = bytes(data[_FILE_HEADER_WITH_TABLE.size : toc])
    signs, unknown_extensions = _read_extensions(between if flags & _EXTENDED_FLAG else b"")
    if between and not flags & _EXTENDED_FLAG:
        unknown_extensions = (f"{len(between)} bytes before the table of contents",)
    streams, offset = {}, toc + stream_count * _TOC_ENTRY.size
    for index, (name, size) in enumerate(parts.items()):
        entry = toc + index * _TOC_ENTRY.size
        packed_size, unpacked_size = _TOC_ENTRY.unpack_from(data, entry)
        if unpacked_size != size:
            raise HeaderMalformed(
                f"stream {name} unpacks to {unpacked_size} bytes",
                where=f"byte {entry + 8}",
                expected=f"{size} bytes",
            )
        require_length(data, offset, packed_size, f"stream {name}")
        content = zstd.unpack(
            bytes(data[offset : offset + packed_size]), size, f"stream {name}, byte {offset}"
        )
        streams[name] = np.frombuffer(content, np.uint8)
        offset += packed_size
    if offset != len(data):
        raise HeaderMalformed(
            f"the file has {len(data)} bytes",
            where="file",
            expected=f"{offset}, the end of the last stream",
        )
    streams = {name: streams.get(name, np.empty(0, np.uint8)) for name in STREAM_NAMES}
    is_antialiased = bool(flags & _ANTIALIASED_FLAG)
    return Frame(
        version=version,
        count=count,
        degree=degree,
        fractional_bits=fraction,
        antialiased=is_antialiased,
        streams=streams,
        signs=signs,
        unused=(*_undefined_header(flags, reserved), *unknown_extensions),
    )


def _require_magic(magic: bytes, data: Data) -> None:
    if magic != MAGIC:
        raise not_recognised(data, "4e 47 53 50 (NGSP), the start of an SPZ", magic.hex(" "))


def _require_header(version: int, count: int, degree: int, fraction: int, size: int) -> None:
    if not 1 <= version <= NEWEST_VERSION:
        raise NotSupported(
            f"the file has SPZ version {version}", where="byte 4", expected="1, 2, 3 or 4"
        )
    if count == 0:
        raise ValueInvalid("the file has 0 splats", where="byte 8", expected="at least one")
    require_count(count, size)
    if degree > _MAX_SH_DEGREE:
        raise HeaderMalformed(f"the SH degree is {degree}", where="byte 12", expected="0 to 4")
    if fraction > _MAX_FRACTIONAL_BITS:
        raise HeaderMalformed(
            f"the positions have {fraction} fractional bits", where="byte 13", expected="0 to 24"
        )


def require_count(count: int, size: int) -> None:
    """Raise FileTruncated if an SPZ file of ``size`` bytes cannot hold ``count`` splats."""
    if count > min(MAX_SPLATS, size * _MAX_SPLATS_PER_NINE_BYTES // 9):
        raise FileTruncated(
            f"the header declares {count} splats in a file of {size} bytes",
            where="byte 8",
            expected=f"at most {size * _MAX_SPLATS_PER_NINE_BYTES // 9}, with the best compression",
            hint=DOWNLOAD_HINT,
        )


def _require_memory(needed: int, max_bytes: int) -> None:
    if needed > max_bytes:
        raise SizeExceeded(
            f"the file unpacks to {needed} bytes",
            expected=f"{max_bytes} bytes or fewer",
            hint="if you trust the file, read it with a larger max_bytes",
        )


def _undefined_header(flags: int, reserved: bytes) -> list[str]:
    """Return the bits and bytes of an SPZ header that are set, and have no meaning."""
    undefined = flags & ~(_ANTIALIASED_FLAG | _EXTENDED_FLAG)
    names = [f"flags {undefined:#04x} of the header"] if undefined else []
    return names + ([f"reserved bytes {reserved.hex(' ')}"] if any(reserved) else [])


def _read_extensions(records: bytes) -> tuple[AxisSigns, tuple[str, ...]]:
    """Return the axis signs that SPZ extension records declare, and the names of unknown ones."""
    signs, offset = RDF_RUB, 0
    unknown: list[str] = []
    while offset < len(records):
        require_length(records, offset, _RECORD_HEADER_STRUCT.size, "extension record")
        kind, length = _RECORD_HEADER_STRUCT.unpack_from(records, offset)
        offset += _RECORD_HEADER_STRUCT.size
        require_length(records, offset, length, f"extension {kind:#x}")
        if kind == _COORDINATES_EXTENSION:
            signs = _declared_signs(records[offset : offset + length])
        elif kind != _CAMERA_EXTENSION:
            unknown.append(f"extension {kind:#x}")
        offset += length
    return signs, tuple(unknown)


def _declared_signs(payload: bytes) -> AxisSigns:
    """Return the axis signs that convert a declared SPZ coordinate system to that of PLY."""
    code = int.from_bytes(payload, "little")
    if not 1 <= code <= 8:
        raise NotSupported(
            f"the coordinate system is {code}",
            where="extension SPZ_ADOBE_coordinate_system",
            expected="1 to 8, whose axes are not swapped",
            hint="save it in RUB, which every reader understands",
        )
    right_bit, up_bit, forward_bit = code - 1 & 1, code - 1 & 2, code - 1 & 4
    return (1 if right_bit else -1, -1 if up_bit else 1, 1 if forward_bit else -1)


def _fields(frame: Frame) -> tuple[bytes, int, int, int, int, int]:
    flags = _ANTIALIASED_FLAG if frame.antialiased else 0
    return MAGIC, frame.version, frame.count, frame.degree, frame.fractional_bits, flags


def pack_gzip(frame: Frame, content: Iterable[Iterable[bytes]]) -> Iterator[bytes]:
    """Yield the bytes of an SPZ file of version 1 to 3; each attribute comes in pieces."""
    packer = zlib.compressobj(6, wbits=31)
    yield packer.compress(_FILE_HEADER.pack(*_fields(frame), 0))
    for pieces in content:  # each attribute has Huffman codes of its own: 4 to 7 % fewer bytes
        for piece in pieces:
            yield packer.compress(piece)
        yield packer.flush(zlib.Z_BLOCK)
    yield packer.flush()


def pack(frame: Frame, content: Mapping[str, bytes]) -> bytes:
    """Return the bytes of an SPZ file with a given header and unpacked attributes."""
    if frame.version <= NEWEST_GZIP_VERSION:
        return b"".join(pack_gzip(frame, ([content[name]] for name in STREAM_NAMES)))
    header_fields = _fields(frame)
    parts = [content[name] for name in STREAM_NAMES if content[name]]
    streams = [zstd.pack(part) for part in parts]
    toc = (_TOC_ENTRY.pack(len(a), len(b)) for a, b in zip(streams, parts, strict=True))
    header = _FILE_HEADER_WITH_TABLE.pack(
        *header_fields, len(parts), _FILE_HEADER_WITH_TABLE.size, bytes(12)
    )
    return b"".join([header, *toc, *streams])
