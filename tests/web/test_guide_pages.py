"""Pages whose lines are copied from the guide, and a page of three.js: in each a person walks.

Pictures of three times are written to the folder `pages` of pytest's temporary files.
"""

import io
import shutil
import subprocess
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.web.onnxruntime_web import ORT_FILES
from support.browser import launched, require_chromium, serving
from support.commands import ROOT
from support.web.guide import LINES
from support.web.packages import package, require_node
from support.web.pages import CLIENT, chromium
from support.web.without_webgpu import THREE, WEBGL_FLAGS
from web_client.package import pack

pytestmark = pytest.mark.slow

_HEAD = '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>Walking</title>\n'
_STYLE = "<style>body { margin: 0 } gsgen-model { width: 320px; height: 240px }</style>\n"


@pytest.fixture(scope="module")
def contents(
    ort_folder: Path, walking_person: bytes, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, bytes]:
    """Return the pages, and the files beside them."""
    served = {f"/gsgen/ort/{name}": (ort_folder / name).read_bytes() for name in ORT_FILES}
    served["/walk.onnx"] = walking_person
    served["/article.html"] = (
        f"{_HEAD}{_STYLE}<p>Before.</p>{LINES['article']}<p>After.</p>".encode()
    )
    served["/three.html"] = (ROOT / "docs/examples/three/walk.html").read_bytes()
    served["/without-webgpu.html"] = (
        f"{_HEAD}{LINES['without-webgpu']}{_STYLE}{LINES['article']}".encode()
    )
    app = tmp_path_factory.mktemp("app")
    for path in built_app(app, ort_folder, walking_person).rglob("*"):
        if path.is_file():
            served[f"/{path.relative_to(app / 'dist').as_posix()}"] = path.read_bytes()
    served["/vite.html"] = served.pop("/index.html")
    return served


def built_app(app: Path, ort_folder: Path, model: bytes) -> Path:
    """Build a Vite app with the client as a package; return its output."""
    packages = package("frameworks", needs_node=True) / "node_modules"
    modules = app / "node_modules"
    modules.mkdir()
    for path in packages.iterdir():
        (modules / path.name).symlink_to(path)
    shutil.unpack_archive(pack(app), modules)
    (modules / "package").rename(modules / "gsgen")
    shutil.copytree(ort_folder, modules / "gsgen/ort")
    (app / "index.html").write_text(_HEAD + _STYLE + LINES["vite"], "utf-8")
    (app / "public").mkdir()
    (app / "public/walk.onnx").write_bytes(model)
    vite = packages / "vite/bin/vite.js"
    command = [require_node(), str(vite), "build", "--target", "esnext"]
    result = subprocess.run(command, cwd=app, capture_output=True, text=True, encoding="utf-8")
    assert result.returncode == 0, result.stderr
    return app / "dist"


@pytest.fixture(scope="module")
def address(contents: dict[str, bytes]) -> Iterator[str]:
    with serving({"gsgen": CLIENT, "three": package(THREE)}, contents) as address:
        yield address


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pages")


def shots(browser: Any, address: str, name: str, pictures: Path) -> list[np.ndarray]:
    """Return three screenshots of a page whose time runs, each once the picture is another one."""
    page = browser.new_context(viewport={"width": 320, "height": 280}).new_page()
    page.set_default_timeout(120_000)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(f"{address}/{name}.html")
    element = "document.querySelector('gsgen-model')"
    if name != "three":
        page.wait_for_function(f"{element}.report")
        assert page.evaluate(f"{element}.report.errors") == []
        renderer = "webgl2" if name == "without-webgpu" else "webgpu"
        assert page.evaluate(f"{element}.report.renderedBy") == renderer
    images: list[np.ndarray] = []
    for _ in range(300):
        data = page.screenshot()
        image = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), np.float64) / 255
        box = image[40:260, 60:260]
        if box.std() > 0.04 and all(psnr(image, other) < 34 for other in images):
            (pictures / f"{name}-{len(images)}.png").write_bytes(data)
            images.append(image)
        if len(images) == 3:
            break
        page.wait_for_timeout(100)
    assert errors == []
    return images


@pytest.mark.parametrize("name", ["article", "vite", "three"])
def test_a_person_walks_in_a_page_that_copies_the_guide(
    name: str, address: str, pictures: Path
) -> None:
    with chromium() as browser:
        images = shots(browser, address, name, pictures)
    assert len(images) == 3
    assert all(psnr(a, b) < 34 for a, b in pairwise(images))


def test_a_person_walks_in_a_page_without_webgpu(address: str, pictures: Path) -> None:
    with launched(require_chromium(), WEBGL_FLAGS) as browser:
        assert len(shots(browser, address, "without-webgpu", pictures)) == 3
