import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.web.onnxruntime_web import ORT_FILES, cached_ort
from support.web import pages
from web.people import export_walking_person


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    with pages.chromium() as browser:
        yield browser


@pytest.fixture(scope="session")
def site(browser: Any) -> Iterator[pages.WebSite]:
    """One page for tests of single modules: compiling kernels takes most of their time."""
    with pages.site(browser) as site:
        site.open()
        yield site


@pytest.fixture(scope="session")
def renderer() -> Renderer:
    return Renderer(rasteriser="tiles")


@pytest.fixture(scope="session")
def ort_folder() -> Path:
    """Return the folder of ONNX Runtime Web; without it fail the test in CI, and skip elsewhere."""
    folder = cached_ort()
    if not all((folder / name).is_file() for name in ORT_FILES):
        message = f"missing: ONNX Runtime Web in {folder}; hint: make ort"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return folder


@pytest.fixture(scope="session")
def ort(site: pages.WebSite, ort_folder: Path) -> None:
    """Serve ONNX Runtime Web beside the client, as pages have it."""
    for name in ORT_FILES:
        site.contents[f"/client/ort/{name}"] = (ort_folder / name).read_bytes()


@pytest.fixture(scope="session")
def walking_person(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a small model of a person who walks on the spot, in 24 frames."""
    return export_walking_person(tmp_path_factory.mktemp("person"))
