"""Parses the chunks of a GLB file, and validates values of its JSON document on access.

The format is that of the glTF 2.0 specification, section 4 (Khronos).
"""

import json
import math
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Final, final

from gsgen.formats.shared.bytes import DOWNLOAD_HINT, Data, not_recognised, require_length
from gsgen.formats.shared.errors import HeaderMalformed, NotSupported, quoted

MAGIC: Final = b"glTF"

COMPRESSION_EXTENSIONS: Final = (
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_draco_mesh_compression",
)
"""Extensions that compress attributes or indices, which are not decoded."""

_FILE_HEADER, _CHUNK_HEADER = struct.Struct("<4sII"), struct.Struct("<I4s")
_MAX_JSON_BYTES = 1 << 28
Json = dict[str, Any]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Container:
    """The JSON document and the binary chunk of a GLB file.

    Attributes:
        document: The parsed JSON.
        data: The bytes of the file.
        start: The byte where the binary chunk begins.
        size: The length of the binary chunk; 0 without one.
        length: The length that the header of a GLB file declares; 0 for others.
    """

    document: Json
    data: Data
    start: int
    size: int
    length: int = 0

    def item(self, group: str, index: object, where: str) -> Json:
        """Return the JSON object ``index`` in the array ``group`` of a glTF document."""
        items = self.document.get(group, [])
        if not isinstance(items, list):
            raise _malformed_error(items, group, "an array")
        number = require_integer(index, where)
        if number >= len(items):
            raise _malformed_error(number, where, f"less than the {len(items)} of {group}")
        if not isinstance(items[number], dict):
            raise _malformed_error(items[number], f"{group}[{number}]", "an object")
        return dict(items[number])


def parse(data: Data) -> Container:
    """Parse the GLB file ``data`` into its JSON document and binary chunk.

    Raises:
        FormatNotRecognised: The data are not a GLB file.
        NotSupported: The version is not 2.
        FileTruncated: The file ends early.
        HeaderMalformed: A chunk has an unknown type, or its JSON is invalid.
    """
    require_length(data, 0, _FILE_HEADER.size + _CHUNK_HEADER.size, "header")
    magic, version, length = _FILE_HEADER.unpack_from(data)
    if magic != MAGIC:
        raise not_recognised(data, "67 6c 54 46 (glTF), the start of a GLB", magic.hex(" "))
    if version != 2:
        raise NotSupported(
            f"the file has glTF version {version}", where="byte 4", expected="version 2"
        )
    require_length(data, 0, length, "header")
    size, kind = _CHUNK_HEADER.unpack_from(data, _FILE_HEADER.size)
    start = _FILE_HEADER.size + _CHUNK_HEADER.size
    if kind != b"JSON" or size > _MAX_JSON_BYTES:
        raise HeaderMalformed(
            f"the first chunk is {kind!r} of {size} bytes",
            where=f"byte {_FILE_HEADER.size}",
            expected=f"a chunk JSON of at most {_MAX_JSON_BYTES} bytes",
        )
    require_length(data, start, size, "chunk JSON")
    document = parse_document(bytes(data[start : start + size]))
    binary_chunk_start, body = start + size, 0
    if binary_chunk_start + _CHUNK_HEADER.size <= min(length, len(data)):
        body, kind = _CHUNK_HEADER.unpack_from(data, binary_chunk_start)
        body = body if kind == b"BIN\0" else 0
        require_length(data, binary_chunk_start + _CHUNK_HEADER.size, body, "chunk BIN")
    return Container(
        document=document,
        data=data,
        start=binary_chunk_start + _CHUNK_HEADER.size,
        size=body,
        length=length,
    )


def require_known_extensions(document: Json, known: Collection[str]) -> None:
    """Raise if a glTF document requires an extension that its reader does not know.

    The specification (section 3.12) forbids to load such a file.

    Args:
        document: The glTF document.
        known: Names of extensions, or their beginnings, which end in ``*``.
    """
    for name in array_member(document, "extensionsRequired", "document"):
        if any(fnmatchcase(str(name), pattern) for pattern in known):
            continue
        is_packed = name in COMPRESSION_EXTENSIONS
        raise NotSupported(
            f"the file needs {name}, which is not {'decoded' if is_packed else 'supported'}",
            where="extensionsRequired",
            expected=f"none but {', '.join(known)}",
            hint="Export the file without compression of meshes."
            if is_packed
            else "Export the file without this extension.",
        )


def parse_document(content: bytes) -> Json:
    """Parse the JSON of a glTF file; raise HeaderMalformed unless it is an object."""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise HeaderMalformed(
            f"the GLB file has invalid JSON ({error})",
            where="chunk JSON",
            expected="JSON",
            hint=DOWNLOAD_HINT,
        ) from error
    if not isinstance(document, dict):
        raise _malformed_error(document, "chunk JSON", "an object")
    return document


def build(document: Json, size: int) -> bytes:
    """Return the first part of a GLB file: header, JSON and the binary chunk's header."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = _FILE_HEADER.size + 2 * _CHUNK_HEADER.size + len(text) + size
    return b"".join(
        [
            _FILE_HEADER.pack(MAGIC, 2, total),
            _CHUNK_HEADER.pack(len(text), b"JSON"),
            text,
            _CHUNK_HEADER.pack(size, b"BIN\0"),
        ]
    )


def require_integer(value: object, where: str, most: int = 2**53) -> int:
    """Return a JSON value if it is a whole number from 0 to ``most``; raise otherwise."""
    number = int(value) if isinstance(value, float) and value.is_integer() else value
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number <= most:
        raise _malformed_error(value, where, f"a whole number from 0 to {most}")
    return number


def object_member(json_object: Mapping[str, Any], key: str, where: str) -> Json:
    """Return the JSON object at key ``key`` of ``json_object``; an empty object if absent."""
    value = json_object.get(key, {})
    if not isinstance(value, dict):
        raise _malformed_error(value, f"{where}.{key}", "an object")
    return value


def array_member(json_object: Mapping[str, Any], key: str, where: str) -> list[Any]:
    """Return the JSON array at key ``key`` of ``json_object``; an empty array if absent."""
    value = json_object.get(key, [])
    if not isinstance(value, list):
        raise _malformed_error(value, f"{where}.{key}", "an array")
    return value


def number_member(
    json_object: Mapping[str, Any], key: str, default: tuple[float, ...], where: str
) -> tuple[float, ...]:
    """Return the JSON array of finite numbers at key ``key`` of ``json_object``, or ``default``."""
    value_list = json_object.get(key, default)
    size = len(default)
    is_valid = isinstance(value_list, list | tuple) and len(value_list) == size
    if not is_valid or not all(_is_finite(value) for value in value_list):
        raise _malformed_error(value_list, f"{where}.{key}", f"{size} finite numbers")
    return tuple(float(value) for value in value_list)


def _is_finite(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300 and not math.isnan(value)


def _malformed_error(value: object, where: str, expected: str) -> HeaderMalformed:
    return HeaderMalformed(quoted(str(value)), where=where, expected=expected)
