"""Debian's chromium, headless, for tests that run a page."""

import atexit
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

INSTALL = "as root: apt-get update && apt-get install -y chromium"

GPU_FLAGS = (
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--enable-unsafe-webgpu",
    "--enable-features=Vulkan,WebGPU",
    "--use-webgpu-adapter=swiftshader",
    "--use-angle=swiftshader",
    "--use-vulkan=swiftshader",
    "--ignore-gpu-blocklist",
    # The words of a page take less time on the processor than in SwiftShader, and WebAssembly runs
    # for less time in tests than its optimising compiler does.
    "--disable-gpu-rasterization",
    "--js-flags=--liftoff-only",
    # Dawn then clears workgroup memory by a loop in each shader. With the extension SwiftShader
    # compiles a store of each word, which takes a page four CPU-seconds.
    "--disable-dawn-features=use_vulkan_zero_initialize_workgroup_memory_extension",
)
"""WebGPU on SwiftShader, which Debian's chromium brings."""


def require_chromium() -> str:
    """Return the path of chromium; without it fail the test in CI, and skip it elsewhere."""
    path = which("chromium")
    missing = [] if path else [f"chromium on the PATH ({INSTALL})"]
    missing += [] if find_spec("playwright") else ["playwright (pip install playwright)"]
    if path is None or missing:
        message = f"missing: {' and '.join(missing)}"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return path


@contextmanager
def launched(path: str, flags: Sequence[str], **options: Any) -> Iterator[Any]:
    """Start the chromium at ``path`` with flags and with Playwright's ``options``, and close it."""
    launcher = playwright_of_process().chromium
    browser = launcher.launch(executable_path=path, args=list(flags), **options)
    try:
        yield browser
    finally:
        browser.close()


class GatedBytes(bytes):
    """Content whose first part is served at once, and the rest when its gate is opened.

    Attributes:
        share: The first part's share of all bytes.
        gate: Opened by the test; after a minute the answer is cut off.
        sent: Bytes that were handed to the network.
    """

    share: float
    gate: threading.Event
    sent: int

    @classmethod
    def of(cls, content: bytes, share: float) -> "GatedBytes":
        """Return the content behind a closed gate."""
        gated = cls(content)
        gated.share, gated.gate, gated.sent = share, threading.Event(), 0
        return gated

    def parts(self) -> Iterator[bytes]:
        """Yield the first part, and the rest when the gate is open."""
        self.sent = int(self.share * len(self))
        yield self[: self.sent]
        if self.gate.wait(60):
            first, self.sent = self.sent, len(self)
            yield self[first:]


CUT = 0
"""In place of a status: half of the content is sent."""


class FlakyBytes(bytes):
    """Content that a server refuses at first.

    Attributes:
        failures: The statuses of the next answers, or ``CUT``; later ones are whole.
    """

    failures: list[int]

    @classmethod
    def of(cls, content: bytes, failures: Sequence[int]) -> "FlakyBytes":
        """Return content that is served after some failures."""
        flaky = cls(content)
        flaky.failures = list(failures)
        return flaky


class Handler(SimpleHTTPRequestHandler):
    """Serves folders by the first part of the path, and bytes by their whole path.

    A path may have headers of its own, such as a content policy.
    """

    def __init__(
        self,
        *words: object,
        folders: Mapping[str, Path],
        contents: Mapping[str, bytes],
        requests: list[str],
        headers: Mapping[str, Mapping[str, str]],
    ) -> None:
        self._folders, self._contents, self._requests = folders, contents, requests
        self._headers = headers
        super().__init__(*words)  # type: ignore[arg-type]

    def translate_path(self, path: str) -> str:
        first, _, remaining = unquote(urlsplit(path).path).lstrip("/").partition("/")
        return str(self._folders.get(first, Path("/nowhere")) / remaining)

    def do_GET(self) -> None:
        path = unquote(urlsplit(self.path).path)
        self._requests.append(path)
        if path not in self._contents:
            super().do_GET()
            return
        body = self._contents[path]
        failures = body.failures if isinstance(body, FlakyBytes) else []
        status = failures.pop(0) if failures else 200
        self.send_response(status or 200)
        self.send_header("Content-Type", self.guess_type(path))
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if status == CUT:
            body = body[: len(body) // 2]
        for part in body.parts() if isinstance(body, GatedBytes) else [body]:
            self.wfile.write(part)

    def end_headers(self) -> None:
        path = unquote(urlsplit(self.path).path)
        for name, value in self._headers.get(path, {}).items():
            self.send_header(name, value)
        self.send_header("Access-Control-Allow-Origin", "*")
        super().end_headers()

    def log_message(self, *words: object) -> None:
        pass


@contextmanager
def serving(
    folders: Mapping[str, Path],
    contents: Mapping[str, bytes],
    requests: list[str] | None = None,
    headers: Mapping[str, Mapping[str, str]] | None = None,
) -> Iterator[str]:
    """Serve folders and bytes on a free port, and yield the address."""
    handler = partial(
        Handler,
        folders=folders,
        contents=contents,
        requests=[] if requests is None else requests,
        headers={} if headers is None else headers,
    )
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


@cache
def playwright_of_process() -> Any:
    """Start Playwright, of which a process can run one at a time; it stops with the process."""
    from playwright.sync_api import sync_playwright

    playwright = sync_playwright().start()
    atexit.register(playwright.stop)
    return playwright
