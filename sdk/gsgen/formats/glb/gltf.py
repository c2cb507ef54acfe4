"""Reads .gltf files: a JSON document whose buffers are in files beside it, or in the text."""

__all__ = ["parse_gltf"]

import base64
import binascii
from collections.abc import Callable
from typing import Any, Final
from urllib.parse import unquote

from gsgen.formats.glb.container import (
    Container,
    array_member,
    object_member,
    parse_document,
    require_integer,
)
from gsgen.formats.shared.errors import (
    FileTruncated,
    HeaderMalformed,
    NotSupported,
    SizeExceeded,
    quoted,
)

_DATA_PREFIX: Final = "data:"

FetchBuffer = Callable[[str, int], bytes]
"""Returns the content of a file beside the .gltf; raises if it has more bytes than allowed."""


def parse_gltf(content: bytes, fetch: FetchBuffer, max_bytes: int) -> Container:
    """Parse a .gltf document, and join its buffers into one, as a GLB file has it.

    Raises:
        HeaderMalformed: The JSON is invalid.
        NotSupported: The version is not 2, or a buffer has no address.
        SizeExceeded: The buffers take more than ``max_bytes``.
        FileTruncated: A buffer is shorter than declared.
    """
    document = parse_document(content)
    asset = object_member(document, "asset", "document")
    if not str(asset.get("version", "")).startswith("2."):
        raise NotSupported(
            f"the file has glTF version {quoted(str(asset.get('version')))}",
            where="asset.version",
            expected="version 2.0",
        )
    starts, joined_buffers = [], bytearray()
    for index, buffer in enumerate(array_member(document, "buffers", "document")):
        where = f"buffers[{index}]"
        if not isinstance(buffer, dict):
            raise HeaderMalformed(quoted(str(buffer)), where=where, expected="an object")
        size = require_integer(buffer.get("byteLength"), f"{where}.byteLength")
        if len(joined_buffers) + size > max_bytes:
            raise SizeExceeded(
                f"the buffers take more than {max_bytes} bytes", where=where, expected="less"
            )
        data = _buffer(buffer, where, fetch, size)
        if len(data) < size:
            raise FileTruncated(
                f"the buffer has {len(data)} bytes", where=where, expected=f"{size} bytes"
            )
        starts.append(len(joined_buffers))
        joined_buffers += data[:size]
        joined_buffers += bytes(-len(joined_buffers) % 8)
    views = array_member(document, "bufferViews", "document")
    moved_views = [_moved_view(view, index, starts) for index, view in enumerate(views)]
    document |= {"buffers": [{"byteLength": len(joined_buffers)}], "bufferViews": moved_views}
    return Container(
        document=document, data=bytes(joined_buffers), start=0, size=len(joined_buffers)
    )


def _buffer(buffer: dict[str, Any], where: str, fetch: FetchBuffer, size: int) -> bytes:
    address = buffer.get("uri")
    if not isinstance(address, str):
        raise NotSupported(
            "the buffer has no address",
            where=where,
            expected="uri, a file beside the .gltf or data in base64",
        )
    if not address.startswith(_DATA_PREFIX):
        return fetch(unquote(address), size)
    head, _, payload = address.partition(",")
    try:
        return base64.b64decode(payload, validate=True) if head.endswith(";base64") else b""
    except (binascii.Error, ValueError) as error:
        raise HeaderMalformed(
            f"the data cannot be decoded ({error})", where=where, expected="base64"
        ) from error


def _moved_view(view: object, index: int, starts: list[int]) -> dict[str, Any]:
    where = f"bufferViews[{index}]"
    if not isinstance(view, dict):
        raise HeaderMalformed(quoted(str(view)), where=where, expected="an object")
    buffer = require_integer(view.get("buffer"), f"{where}.buffer")
    if buffer >= len(starts):
        raise HeaderMalformed(
            str(buffer), where=f"{where}.buffer", expected=f"less than {len(starts)}"
        )
    offset = require_integer(view.get("byteOffset", 0), f"{where}.byteOffset")
    return {**view, "buffer": 0, "byteOffset": starts[buffer] + offset}
