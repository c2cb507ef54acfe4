"""CesiumJS in a headless browser: what the viewer that others use makes of a tileset."""

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
import pytest
from PIL import Image

from support.browser import launched, serving

CESIUM = Path(__file__).parents[3] / ".venv/npm/cesium-1.145.0"
PAGE = Path(__file__).with_name("page.html")
_SECONDS = 180
_WEBGL_FLAGS = (
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)


@dataclass(frozen=True, slots=True)
class Seen:
    """What the viewer told.

    Attributes:
        loaded: The contents that were loaded, relative to the tileset's folder.
        failed: Addresses of those that were not, and why.
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


class Viewer:
    """One page with CesiumJS, which shows one tileset after another."""

    def __init__(self, page: Any, folders: dict[str, Path]) -> None:
        self._page = page
        self._folders = folders  # those that the page's server has

    def view(self, folder: Path) -> Seen:
        """Load ``folder/tileset.json`` and look at it from the south-west, from above."""
        name = f"set{len(self._folders)}"
        self._folders[name] = folder
        report = self._page.evaluate("(url) => view(url)", f"/{name}/tileset.json")
        assert "picture" in report, report["errors"]
        loaded = [url.partition(f"/{name}/")[2] for url in report.pop("loaded")]
        data = base64.b64decode(report.pop("picture").partition(",")[2])
        picture = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
        return Seen(loaded=loaded, picture=picture, **report)


@contextmanager
def opened_viewer() -> Iterator[Viewer]:
    """Open the page; fail with the script to run where CesiumJS or chromium is missing."""
    chromium = which("chromium")
    missing_files = [] if (CESIUM / "Cesium.js").is_file() else [f"CesiumJS in {CESIUM}"]
    missing_files += [] if chromium else ["chromium on the PATH"]
    if chromium is None or missing_files:
        pytest.fail(
            f"missing: {' and '.join(missing_files)}; hint: run scripts/fetch.sh cesium as root"
        )
    folders = {"cesium": CESIUM}
    with (
        serving(folders, {"/index.html": PAGE.read_bytes()}) as address,
        launched(chromium, _WEBGL_FLAGS) as browser,
    ):
        page = browser.new_page(viewport={"width": 480, "height": 360})
        page.set_default_timeout(1000 * _SECONDS)
        page.goto(f"{address}/index.html")
        yield Viewer(page, folders)
