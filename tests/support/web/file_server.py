"""A web server of given files, which keeps the requests that it gets."""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass(frozen=True)
class Served:
    """An answer of the server: a file, or a status with headers."""

    body: bytes = b""
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)


def redirect_to(address: str) -> Served:
    return Served(status=302, headers={"Location": address})


@dataclass
class FileServer:
    """A running server.

    Attributes:
        files: Path → its answer; paths that are absent are answered 404.
        requests: The requested paths with their queries, and the headers.
    """

    port: int
    files: dict[str, bytes | Served]
    requests: list[tuple[str, Mapping[str, str]]] = field(default_factory=list)

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def address_of(self, path: str) -> str:
        return self.origin + path

    @property
    def paths(self) -> list[str]:
        return [path for path, _ in self.requests]


@contextmanager
def file_server(files: Mapping[str, bytes | Served]) -> Iterator[FileServer]:
    """Serve files until the block ends; ``/a.ply`` answers all queries, ``/a.ply?q`` this one."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            server.requests.append((self.path, dict(self.headers)))
            known = server.files.get(self.path, server.files.get(self.path.partition("?")[0]))
            answer = Served(status=404) if known is None else known
            answer = Served(answer) if isinstance(answer, bytes) else answer
            self.send_response(answer.status)
            for name, value in {"Content-Length": str(len(answer.body)), **answer.headers}.items():
                self.send_header(name, value)
            self.end_headers()
            if self.command == "GET":
                self.wfile.write(answer.body)

        def do_HEAD(self) -> None:
            self.do_GET()

        def log_message(self, format: str, *words: object) -> None:
            pass

    web_server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server = FileServer(web_server.server_port, dict(files))
    thread = threading.Thread(target=web_server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        web_server.shutdown()
        web_server.server_close()
        thread.join()
