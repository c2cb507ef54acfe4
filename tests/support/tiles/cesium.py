"""CesiumJS in a headless browser: what the viewer that others use makes of a tileset."""

import base64
import io
import json
import subprocess
import tempfile
import threading
from dataclasses import dataclass
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from shutil import which

import numpy as np
import pytest
from PIL import Image

CESIUM = Path(__file__).parents[3] / ".venv" / "cesium"
PAGE = Path(__file__).with_name("cesium_page.html")
_SECONDS = 180


def require_viewer() -> None:
    """Fail the test, with the script to run, where CesiumJS or chromium is missing."""
    absent = [] if (CESIUM / "Cesium.js").is_file() else [f"CesiumJS in {CESIUM}"]
    absent += [] if which("chromium") else ["chromium on the PATH"]
    if absent:
        pytest.fail(f"missing: {' and '.join(absent)}; hint: run scripts/cesium.sh as root")


@dataclass(frozen=True, slots=True)
class Seen:
    """What the viewer told.

    Attributes:
        loaded: Addresses of the contents that were loaded.
        failed: Those that were not, and why.
        errors: Of the page and the renderer.
        tiles: How many tiles the tileset has.
        selected: How many are drawn.
        splats: How many splats are drawn.
        picture: RGB, [height, width, 3].
    """

    loaded: list[str]
    failed: list[str]
    errors: list[str]
    tiles: int
    selected: int
    splats: int
    picture: np.ndarray


class _Handler(SimpleHTTPRequestHandler):
    def __init__(
        self, *words: object, report: dict[str, object], done: threading.Event, **named: object
    ) -> None:
        self._report, self._done = report, done
        super().__init__(*words, **named)  # type: ignore[arg-type]

    def do_POST(self) -> None:
        size = int(self.headers["Content-Length"])
        self._report.update(json.loads(self.rfile.read(size)))
        self.send_response(204)
        self.end_headers()
        self._done.set()

    def log_message(self, *words: object) -> None:
        pass


def view(folder: Path) -> Seen:
    """Load ``folder/tileset.json`` and look at it from the south-west, from above."""
    report: dict[str, object] = {}
    done = threading.Event()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as work:
        site, profile = Path(work) / "site", Path(work) / "profile"
        site.mkdir()
        (site / "cesium").symlink_to(CESIUM)
        (site / "set").symlink_to(folder.resolve())
        (site / "index.html").write_bytes(PAGE.read_bytes())
        handler = partial(_Handler, directory=str(site), report=report, done=done)
        with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
            thread = threading.Thread(target=server.serve_forever, args=(0.05,))
            thread.start()
            command = [
                "chromium", "--headless=new", "--no-sandbox", "--disable-dev-shm-usage",
                "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                f"--user-data-dir={profile}",
                f"http://127.0.0.1:{server.server_port}/index.html",
            ]  # fmt: skip
            browser = subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            try:
                assert done.wait(_SECONDS), "the page told nothing"
            finally:
                browser.terminate()
                browser.wait(30)
                server.shutdown()
                thread.join()
    assert "picture" in report, report["errors"]
    data = base64.b64decode(str(report.pop("picture")).partition(",")[2])
    picture = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
    return Seen(picture=picture, **report)  # type: ignore[arg-type]
