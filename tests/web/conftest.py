from collections.abc import Iterator
from typing import Any

import pytest

from gsgen.runtime.renderer.renderer import Renderer
from support.web import pages


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
