"""The drop page, from disk: files that are chosen are drawn and judged, and nothing is asked of a server."""

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.formats import Splats, write_ply
from support.commands import ROOT
from support.web.pages import chromium

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Open the page in one file, as it lies on a disk; without what runs generators."""
    spec = importlib.util.spec_from_file_location("write_live", ROOT / "scripts/write_live.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    file = tmp_path_factory.mktemp("drop") / "drop.html"
    file.write_text(script.drop_page(None, None), "utf-8")
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 390, "height": 600})
        page.set_default_timeout(120_000)
        requests: list[str] = []
        page.on("request", lambda request: requests.append(request.url))
        page.goto(file.as_uri())
        yield page
        assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []


def choose(page: Any, *files: Path) -> str:
    """Choose files, and return what the page says of them."""
    page.evaluate("() => document.querySelector('#drop-report').replaceChildren()")
    page.set_input_files("#drop-files", [str(file) for file in files])
    page.wait_for_function("() => document.querySelector('#drop-report h2')")
    return str(page.inner_text("#drop-report"))


def splats(path: Path, count: int) -> Path:
    """Write a ball of red splats."""
    rng = np.random.default_rng(0)
    write_ply(
        path,
        Splats(
            position=rng.normal(size=(count, 3)).astype(np.float32),
            rotation=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
            log_scale=np.full((count, 3), -1, np.float32),
            logit_opacity=np.full(count, 3, np.float32),
            sh=np.tile(np.float32([1.7, -1.7, -1.7]), (count, 1, 1)),
        ),
    )
    return path


def test_splats_are_drawn_and_measured(page: Any, tmp_path: Path) -> None:
    ply = splats(tmp_path / "ball.ply", 300)
    text = choose(page, ply)
    assert "Drawn." in text
    assert "Gaussians\t300" in text
    assert f"{ply.stat().st_size / 1000:.1f} kB" in text
    assert "gsgen render ball.ply -o picture.png" in text
    page.locator("gsgen-scene").screenshot(path=str(tmp_path / "ball.png"))


def test_a_broken_model_is_explained(page: Any, tmp_path: Path) -> None:
    text = choose(page, find("declared_output_absent").write(tmp_path))
    assert "Not drawn." in text
    assert "GM004" in text
    assert "gsgen explain GM004" in text
    assert "gsgen validate declared_output_absent.onnx" in text


def test_a_scene_finds_the_files_that_were_dropped_with_it(page: Any, tmp_path: Path) -> None:
    ply = splats(tmp_path / "part.ply", 200)
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps({"gsgen_scene": "1.0", "models": ["part.ply"]}), "utf-8")
    assert "Gaussians\t200" in choose(page, scene, ply)
    assert "was not dropped with the others" in choose(page, scene)


def test_the_names_of_files_are_no_html(page: Any, tmp_path: Path) -> None:
    odd = tmp_path / "<img src=x onerror=alert(1)>.ply"
    odd.write_bytes(b"nothing")
    assert "<img" in choose(page, odd)
    assert page.locator("#drop-report img").count() == 0
