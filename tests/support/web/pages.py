"""Pages of the browser client in chromium, and what tests send to them and read from them."""

import base64
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.runtime.web.serving import ModelServer
from support.browser import GPU_FLAGS, launched, require_chromium, serving

CLIENT = Path(str(files("gsgen.runtime.web").joinpath("client")))
_SECONDS = 180


@dataclass(slots=True)
class WebSite:
    """A served page in a running browser.

    Attributes:
        page: The page, by playwright.
        address: Address of the server.
        contents: Bytes that are served, by path; tests may add some.
        requests: The paths that were requested.
        headers: Headers of answers, by path; tests may add some.
        errors: What the page or its console reported as errors.
    """

    page: Any
    address: str
    contents: dict[str, bytes]
    requests: list[str]
    headers: dict[str, dict[str, str]] = field(default_factory=dict)
    errors: list[str] = field(default_factory=list)

    def open(self, path: str = "/test/harness.html") -> None:
        """Load a page of the server."""
        self.errors.clear()
        self.page.goto(self.address + path)

    def call(self, function: str, *arguments: Any) -> Any:
        """Call an exported function of harness.js, and return its result."""
        script = "([name, args]) => import('/test/harness.js').then((m) => m[name](...args))"
        return self.page.evaluate(script, [function, list(arguments)])


@contextmanager
def chromium() -> Iterator[Any]:
    """Start chromium with WebGPU on SwiftShader."""
    swiftshader = ["--enable-unsafe-swiftshader"]
    with launched(require_chromium(), GPU_FLAGS, ignore_default_args=swiftshader) as browser:
        yield browser


@contextmanager
def site(browser: Any, **folders: Path) -> Iterator[WebSite]:
    """Serve the client, and open a page of it."""
    contents: dict[str, bytes] = {"/favicon.ico": b""}  # which browsers ask for
    requests: list[str] = []
    headers: dict[str, dict[str, str]] = {}
    served = {"client": CLIENT, "test": Path(__file__).parent, **folders}
    with serving(served, contents, requests, headers) as address:
        context = browser.new_context(viewport={"width": 640, "height": 480})
        page = context.new_page()
        page.set_default_timeout(1000 * _SECONDS)
        result = WebSite(page, address, contents, requests, headers)
        page.on("pageerror", lambda error: result.errors.append(f"page: {error}"))
        page.on("console", lambda message: _keep(result.errors, message))
        try:
            yield result
        finally:
            context.close()


@contextmanager
def running(server: ModelServer) -> Iterator[str]:
    """Run the server of `gsgen view --web`, and yield its address."""
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield server.address
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def _keep(errors: list[str], message: Any) -> None:
    if message.type == "error":
        errors.append(f"console: {message.text}")


def float32_result(page: Any, function: str, argument: Any = None) -> np.ndarray:
    """Return the Float32Array that an async JavaScript function yields; as JSON it takes seconds.

    Args:
        page: The page, by playwright.
        function: Source of the function.
        argument: Its argument.
    """
    script = f"""async (argument) => {{
      const numbers = await ({function})(argument);
      const url = await new Promise((resolve) => {{
        const reader = new FileReader();
        reader.onload = () => resolve(reader.result);
        reader.readAsDataURL(new Blob([numbers]));
      }});
      return url.slice(url.indexOf(",") + 1);
    }}"""
    return unpacked(page.evaluate(script, argument), np.float32)


def packed(array: np.ndarray) -> str:
    """Return an array's bytes as base64, as harness.js reads them."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def unpacked(text: str, dtype: type[np.generic]) -> np.ndarray:
    """Return the array of a base64 text that harness.js wrote."""
    return np.frombuffer(base64.b64decode(text), dtype)
