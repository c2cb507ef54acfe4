"""Reads the bodies of HTTP responses piece by piece: on time, whole, decoded, within a budget."""

__all__ = ["body_chunks"]

import zlib
from collections.abc import Iterator
from http.client import HTTPException, HTTPResponse
from typing import Final

from gsgen.contract.fetching.deadline import Deadline, DeadlineSocket

_CHUNK_BYTES: Final = 1 << 18
_MIN_BYTES_PER_STALL_TIME: Final = 1024  # bytes that a server has to send in each stall time
_ZLIB_FORMATS: Final = {"gzip": 31, "x-gzip": 31, "deflate": 15}
_CODING_OVERHEAD: Final = 1 << 16  # bytes that a coded body may be larger than its content


def body_chunks(
    response: HTTPResponse,
    connection: DeadlineSocket,
    deadline: Deadline,
    *,
    stall: float,
    max_bytes: int,
) -> Iterator[bytes]:
    """Yield the decoded pieces of a response's body as they come.

    Args:
        response: Whose headers were read.
        connection: Where it comes from.
        deadline: Of the whole body.
        stall: Seconds in each of which a kilobyte has to come.
        max_bytes: Most decoded bytes that the caller takes; a coded body may not have many more.

    Raises:
        TimeoutError: The body does not come in time.
        OSError: The connection broke.
        HTTPException: The body ends early, cannot be decoded, or its chunks are malformed.
        ValueError: Its chunks are malformed.
    """
    received = _received_chunks(response, connection, deadline, stall)
    content_coding = (response.getheader("Content-Encoding") or "").strip().lower()
    if content_coding in ("", "identity"):
        yield from received
    elif content_coding in _ZLIB_FORMATS:
        yield from _decoded_chunks(received, content_coding, max_bytes + _CODING_OVERHEAD)
    else:
        raise HTTPException(f"its Content-Encoding is {content_coding:.40}, not gzip or deflate")


def _received_chunks(
    response: HTTPResponse, connection: DeadlineSocket, deadline: Deadline, stall: float
) -> Iterator[bytes]:
    missing = response.length  # None for chunks, and until the connection is closed
    window, window_bytes = deadline.within(stall), 0
    while missing != 0:
        connection.deadline = window
        chunk = response.read1(_CHUNK_BYTES)
        if not chunk:
            break
        if missing is not None:
            missing -= len(chunk)
        window_bytes += len(chunk)
        if window_bytes >= _MIN_BYTES_PER_STALL_TIME:
            window, window_bytes = deadline.within(stall), 0
        yield chunk
    if missing:
        raise HTTPException(f"{missing:,} bytes are missing")


def _decoded_chunks(
    received: Iterator[bytes], content_coding: str, max_coded_bytes: int
) -> Iterator[bytes]:
    """Undo gzip or deflate in small pieces, so that no body exhausts the memory."""
    decoder = zlib.decompressobj(_ZLIB_FORMATS[content_coding])
    for chunk in received:
        max_coded_bytes -= len(chunk)
        if max_coded_bytes < 0:
            raise HTTPException(f"the {content_coding} stream does not end")
        while chunk and not decoder.eof:
            try:
                piece = decoder.decompress(chunk, _CHUNK_BYTES)
            except zlib.error as error:
                raise HTTPException(f"the body is not {content_coding}") from error
            chunk = decoder.unconsumed_tail
            yield piece
    if not decoder.eof:
        raise HTTPException(f"the {content_coding} stream is truncated")
