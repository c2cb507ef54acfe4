"""Opens the content of a tile: a .glb file, or a .gltf file with all buffers joined."""

__all__ = ["MAX_CONTENT_BYTES", "Fetch", "open_content", "raise_as_fault"]

import base64
import binascii
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final
from urllib.parse import unquote_to_bytes

from gsgen.formats.glb.container import Container, parse, require_known_extensions
from gsgen.formats.glb.splats import READABLE_EXTENSIONS
from gsgen.formats.shared.errors import FormatError
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.json_values import JsonDict, JsonObject, parse_object

MAX_CONTENT_BYTES: Final = 512 << 20
"""Most bytes of the file of one tile, and of all its buffers together."""
_DATA_URI = re.compile(r"^data:([^,;]*)((?:;[^,;]*)*),", re.DOTALL)

Fetch = Callable[[str, str, int], bytes]
"""Takes a uri, the location it stands at and the bytes that are needed."""


def open_content(data: bytes, location: str, fetch: Fetch | None = None) -> Container:
    """Return the JSON and the joined buffers of a ``.glb`` or ``.gltf`` file.

    Args:
        data: The file.
        location: Its name, for errors.
        fetch: Reads a buffer in a file of its own; without it, that is an error.
    """
    if data[:4] == b"glTF":
        with raise_as_fault(location, Fault.CONTENT):
            return parse(data)
    document = parse_object(data, f"{location}, ", fault=Fault.CONTENT)
    version = document.child("asset").text("version")
    if not version.startswith("2."):
        document.child("asset").refuse("version", "2.0, or a later 2")
    with raise_as_fault(location, Fault.CONTENT):
        require_known_extensions(document.values, READABLE_EXTENSIONS)
    return _join_buffers(document, fetch)


def _join_buffers(document: JsonObject, fetch: Fetch | None) -> Container:
    """Join the buffers of a .gltf file into one, and adapt the buffer views."""
    buffer_starts, joined_buffer = [], bytearray()
    buffers = list(document.objects("buffers"))
    sizes = [buffer.whole("byteLength") for buffer in buffers]
    if sum(sizes) > MAX_CONTENT_BYTES:
        raise TilesetInvalid(
            f"the glTF buffers have {sum(sizes):,} bytes",
            location=document.at("buffers"),
            expected=f"{MAX_CONTENT_BYTES:,} bytes or fewer",
            fault=Fault.CONTENT,
        )
    for buffer, size in zip(buffers, sizes, strict=True):
        content = _read_buffer(buffer, size, fetch)
        if len(content) < size:
            raise TilesetInvalid(
                f"the glTF buffer has {len(content)} bytes",
                location=buffer.location,
                expected=f"{size}",
                fault=Fault.CONTENT,
            )
        buffer_starts.append(len(joined_buffer))
        joined_buffer += content[:size]
    views: list[JsonDict] = []
    for view in document.objects("bufferViews"):
        index = view.whole("buffer")
        if index >= len(buffer_starts):
            view.refuse("buffer", f"less than the {len(buffer_starts)} buffers")
        offset = view.whole("byteOffset") if "byteOffset" in view else 0
        end = offset + view.whole("byteLength")
        next_start = [*buffer_starts[index + 1 :], len(joined_buffer)][0]
        if buffer_starts[index] + end > next_start:
            view.refuse("byteLength", "less than the buffer is long")
        views.append({**view.values, "buffer": 0, "byteOffset": buffer_starts[index] + offset})
    values = {**document.values, "bufferViews": views}
    values["buffers"] = [{"byteLength": len(joined_buffer)}]
    return Container(document=values, data=bytes(joined_buffer), start=0, size=len(joined_buffer))


def _read_buffer(buffer: JsonObject, size: int, fetch: Fetch | None) -> bytes:
    uri = buffer.text("uri")
    match = _DATA_URI.match(uri)
    if match:
        body = uri[match.end() :]
        try:
            if match[2].endswith(";base64"):
                return base64.b64decode(unquote_to_bytes(body), validate=True)
        except (ValueError, binascii.Error) as error:
            raise TilesetInvalid(
                f"the data URI holds base64 that cannot be decoded ({error})",
                location=buffer.at("uri"),
                expected="valid base64",
                fault=Fault.CONTENT,
            ) from error
        return unquote_to_bytes(body)
    if fetch is None:
        buffer.refuse("uri", "a data URI")
    return fetch(uri, buffer.at("uri"), size)


@contextmanager
def raise_as_fault(location: str, fault: Fault) -> Iterator[None]:
    """Convert file format errors in a ``with`` block to tileset errors of a given fault kind."""
    try:
        yield
    except FormatError as error:
        raise TilesetInvalid(
            error.message,
            location=f"{location}, {error.where}" if error.where else location,
            expected=error.expected,
            hint=error.hint,
            fault=fault,
        ) from error
