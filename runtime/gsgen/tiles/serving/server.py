"""An HTTP server of a folder with ranges, ETags, packed JSON and simulated network faults."""

__all__ = ["TileServer", "serve_folder"]

import gzip
import hashlib
import io
import os
import re
import stat
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import lru_cache
from http import HTTPStatus
from pathlib import Path
from typing import BinaryIO, Final, final
from urllib.parse import unquote, urlsplit

from gsgen.contract.reporters.summary import printable
from gsgen.runtime.web.local_server import LocalHandler, LocalServer
from gsgen.tiles.format.uris import DIGEST_IN_PATH
from gsgen.tiles.serving.faults import NetworkFaults

_CHUNK_BYTES = 16 << 10
_STALL_SECONDS = 60.0
_MAX_WHOLE_BYTES: Final = 64 << 20  # of a file that is read whole, to pack or to hash it
_GZIP_LEVEL: Final = 6
_RANGE_PATTERN = re.compile(r"^bytes=(\d*)-(\d*)$")
_LONGEST_NUMBER = 18
_FORBIDDEN_CHARACTERS: Final = frozenset("\\:\0")
_MIME_TYPES: Final = {
    ".json": "application/json",
    ".glb": "model/gltf-binary",
    ".gltf": "model/gltf+json",
    ".subtree": "application/octet-stream",
    ".3tz": "application/vnd.maxar.archive.3tz+zip",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript",
    ".css": "text/css",
    ".wasm": "application/wasm",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".svg": "image/svg+xml",
}

LogFunction = Callable[[str], None]


@final
@dataclass(frozen=True, slots=True)
class _ByteSpan:
    """The byte range of a file that an HTTP response sends."""

    start: int
    size: int


@final
class TileServer(LocalServer):
    """Serves the files of a folder over HTTP.

    Attributes:
        folder: The folder.
        faults: What happens to answers.
        log: Called with a line per response.
    """

    def __init__(
        self,
        folder: Path,
        *,
        host: str,
        port: int,
        faults: NetworkFaults,
        log: LogFunction,
        cors: Collection[str],
    ) -> None:
        self.folder, self.faults, self.log = folder.resolve(), faults, log
        super().__init__(host, port, _Handler, cors=cors)


def serve_folder(
    folder: Path,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    faults: NetworkFaults | None = None,
    log: LogFunction = lambda line: None,
    cors: Collection[str] = (),
) -> TileServer:
    """Return a listening server of ``folder``; call ``serve_forever`` to answer requests.

    Args:
        folder: Served; files outside it, and hidden ones, are not.
        host: The address to listen at.
        port: The port; 0 for one that is free.
        faults: What happens to answers; nothing where absent.
        log: Called with a line per response.
        cors: Origins whose pages may read the files, beside the server's own; ``*`` for all.

    Raises:
        OSError: The port is taken.
    """
    return TileServer(
        folder, host=host, port=port, faults=faults or NetworkFaults(), log=log, cors=cors
    )


@final
class _Handler(LocalHandler):
    server: TileServer

    def answer(self, *, with_body: bool) -> None:
        """Answer a request with a file, or a byte range of it."""
        faults = self.server.faults
        faults.wait_to_begin()
        failure = faults.choose()
        if isinstance(failure, int):
            self._send_refusal(HTTPStatus(failure), with_body=with_body)
            return
        if failure == "stall":
            faults.sleep(_STALL_SECONDS)
            self.close_connection = True
            return
        stream = self._open_file()
        if stream is None:
            self._send_refusal(HTTPStatus.NOT_FOUND, with_body=with_body)
            return
        with stream:
            self._send_stream(stream, with_body=with_body, cut=failure == "cut")

    def _send_stream(self, stream: BinaryIO, *, with_body: bool, cut: bool) -> None:
        """Answer a request from an open file."""
        file, status = Path(stream.name), os.fstat(stream.fileno())
        size, is_json = status.st_size, "json" in _mime_type(file)
        is_packed = is_json and size <= _MAX_WHOLE_BYTES and "Range" not in self.headers
        is_packed = is_packed and self._takes_gzip()
        etag = f'"{status.st_mtime_ns:x}-{size:x}{"-gzip" if is_packed else ""}"'
        headers = [("Vary", "Accept-Encoding")] if is_json else []
        if etag in (self.headers.get("If-None-Match") or ""):
            self._write_head(HTTPStatus.NOT_MODIFIED, file, etag, headers)
            return
        if is_packed:
            headers.append(("Content-Encoding", "gzip"))
            stream = io.BytesIO(gzip.compress(stream.read(), _GZIP_LEVEL, mtime=0))
            size = len(stream.getbuffer())
        span = self._requested_byte_span(size, etag)
        if span is None:
            self._send_refusal(
                HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE,
                with_body=with_body,
                headers=[("Content-Range", f"bytes */{size}")],
            )
            return
        is_partial_response = span.size < size
        headers.append(("Content-Length", str(span.size)))
        if is_partial_response:
            last = span.start + span.size - 1
            headers.append(("Content-Range", f"bytes {span.start}-{last}/{size}"))
        code = HTTPStatus.PARTIAL_CONTENT if is_partial_response else HTTPStatus.OK
        self._write_head(code, file, etag, headers)
        if with_body:
            self._send_body(stream, span, cut=cut)

    def _takes_gzip(self) -> bool:
        """Return whether the client takes a gzip body: it names gzip or ``*``, and not with q=0."""
        codings = (self.headers.get("Accept-Encoding") or "").lower().replace(" ", "").split(",")
        weights = dict(coding.partition(";q=")[::2] for coding in codings)
        return (weights.get("gzip", weights.get("*", "0")) or "1").strip("0.") != ""

    def _open_file(self) -> BinaryIO | None:
        """Open the requested file; None if it is hidden, or not a readable file in the folder."""
        path = unquote(urlsplit(self.path).path, errors="surrogateescape")
        parts = (path.removeprefix("/") or "index.html").split("/")
        if not all(map(_is_served_name, parts)):
            return None
        try:
            file = self.server.folder.joinpath(*parts)
            resolved = file.resolve().relative_to(self.server.folder)
            is_regular = stat.S_ISREG(file.stat().st_mode)
            is_open = is_regular and all(map(_is_served_name, resolved.parts))
            return file.open("rb") if is_open else None
        except (OSError, ValueError):
            return None

    def _requested_byte_span(self, size: int, etag: str) -> _ByteSpan | None:
        """Return the byte range that an HTTP request asks for; None if unsatisfiable."""
        match = _RANGE_PATTERN.match(self.headers.get("Range") or "")
        if_range = self.headers.get("If-Range")
        if match is None or match[0] == "bytes=-" or if_range not in (None, etag):
            return _ByteSpan(0, size)
        if max(len(match[1]), len(match[2])) > _LONGEST_NUMBER:
            return None
        if not match[1]:  # the last so many
            count = min(int(match[2]), size)
            return _ByteSpan(size - count, count) if count else None
        start = int(match[1])
        end = min(int(match[2]), size - 1) if match[2] else size - 1
        return _ByteSpan(start, end - start + 1) if start <= end else None

    def _write_head(
        self, status: HTTPStatus, file: Path, etag: str, headers: list[tuple[str, str]]
    ) -> None:
        self.send_response(status)
        is_immutable = _names_its_bytes(file, etag)
        cache_control = "public, max-age=31536000, immutable" if is_immutable else "no-cache"
        for name, value in [
            ("Content-Type", _mime_type(file)),
            ("ETag", etag),
            ("Accept-Ranges", "bytes"),
            ("Cache-Control", cache_control),
            *headers,
        ]:
            self.send_header(name, value)
        self.end_headers()
        self._log(status)

    def _log(self, status: HTTPStatus) -> None:
        self.server.log(f"{status.value} {printable(self.path)}")

    def _send_refusal(
        self, status: HTTPStatus, *, with_body: bool, headers: list[tuple[str, str]] | None = None
    ) -> None:
        body = f"{status.value} {status.phrase}\n".encode()
        self.send_response(status)
        self.send_header("Content-Type", "text/plain")
        self.send_header("Content-Length", str(len(body)))
        for name, value in headers or []:
            self.send_header(name, value)
        self.end_headers()
        if with_body:
            self.wfile.write(body)
        self._log(status)

    def _send_body(self, stream: BinaryIO, span: _ByteSpan, *, cut: bool) -> None:
        size, sent = span.size // 2 if cut else span.size, 0
        is_fast = self.server.faults.bytes_per_second is None
        if is_fast and size > self.wbufsize:
            self.wfile.flush()
            sent = self.connection.sendfile(stream, span.start, size)
        else:
            stream.seek(span.start)
            for chunk in _chunks(stream, size):
                self.server.faults.wait_to_send(len(chunk))
                self.wfile.write(chunk)
                sent += len(chunk)
                if not is_fast:
                    self.wfile.flush()
        if sent < span.size:  # cut, or the file was cut meanwhile
            self.close_connection = True


def _mime_type(file: Path) -> str:
    return _MIME_TYPES.get(file.suffix.lower(), "application/octet-stream")


@lru_cache(maxsize=1 << 14)
def _names_its_bytes(file: Path, etag: str) -> bool:
    """Return whether a path has the digest of its file, which has an ETag: others have a date."""
    digest = DIGEST_IN_PATH.search(file.as_posix())
    if digest is None or file.stat().st_size > _MAX_WHOLE_BYTES:
        return False
    return hashlib.sha256(file.read_bytes()).hexdigest().startswith(digest[1])


def _is_served_name(name: str) -> bool:
    """Return whether a file or folder of this name is served: hidden ones and ``..`` are not."""
    return bool(name) and not name.startswith(".") and not set(name) & _FORBIDDEN_CHARACTERS


def _chunks(stream: BinaryIO, size: int) -> Iterator[bytes]:
    remaining = size
    while remaining > 0:
        chunk = stream.read(min(_CHUNK_BYTES, remaining))
        if not chunk:
            return
        remaining -= len(chunk)
        yield chunk
