"""Meshes in scene files of pages: three.js draws them among the Gaussians, as Python draws them."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from gsgen.conformance.viewer_kit.write import kit_cases
from gsgen.formats import write_ply, write_spz
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.web.onnxruntime_web import ORT_FILES
from support.tiles.builds import SMALL, build
from support.web import pages
from support.web.packages import package
from support.web.scene_pages import HEIGHT, WIDTH, decibels, picture, rendered, shown
from support.web.without_webgpu import IMPORT_MAP, THREE

pytestmark = pytest.mark.slow

_WHOLE, _SPLATS = 40, 90  # decibels to Python
_PAGE = f"""<!doctype html><meta charset=utf-8>{IMPORT_MAP}
  <style>gsgen-scene {{ width: {WIDTH}px; height: {HEIGHT}px; aspect-ratio: auto }}</style>
  <script type=module src=/client/scene.js></script><body></body>""".encode()
_GENERATORS = {"time-in-seconds", "view-row", "count-changes"}
_EYES = ["look-at:0.4,-1.2,-7,0,0,0", "look-at:3,-1,-6,0.2,0,0"]


@pytest.fixture(scope="module")
def site(browser: Any, ort_folder: Path) -> Iterator[pages.WebSite]:
    with pages.site(browser, three=package(THREE)) as site:
        for name in ORT_FILES:
            site.contents[f"/client/ort/{name}"] = (ort_folder / name).read_bytes()
        yield site


def checkered(shape: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a shape with a checkered texture, and a factor of its colours."""
    uv = np.stack([np.arctan2(shape.vertices[:, 0], shape.vertices[:, 2]), shape.vertices[:, 1]], 1)
    squares = (np.indices((8, 8)).sum(axis=0) % 2)[..., None] * np.uint8([225, 180, 90]) + 20
    material = PBRMaterial(
        baseColorTexture=Image.fromarray(squares.astype(np.uint8)),
        baseColorFactor=[255, 230, 200, 255],
    )
    shape.visual = TextureVisuals(uv=uv, material=material)
    return shape


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two splat files, three generators, a tileset, and meshes in each format."""
    folder = tmp_path_factory.mktemp("scene")
    write_ply(folder / "knot.ply", torus_knot(600, degree=1))
    write_spz(folder / "knot.spz", torus_knot(500, degree=1))
    build([folder / "knot.ply"], folder / "tiles", replace(SMALL, leaf=200))
    for case in kit_cases():
        if case.name in _GENERATORS:
            case.spec().write(folder / f"{case.name}.onnx")
    checkered(trimesh.creation.box((2, 2, 2))).export(folder / "box.glb")
    return folder


@pytest.fixture(scope="module")
def page(site: pages.WebSite, folder: Path) -> Iterator[Any]:
    for path in folder.rglob("*"):
        if path.is_file():
            site.contents[f"/{path.relative_to(folder).as_posix()}"] = path.read_bytes()
    site.contents["/meshes.html"] = _PAGE
    site.open("/meshes.html")
    site.page.wait_for_function("Boolean(customElements.get('gsgen-scene'))")
    yield site.page
    site.open()


def save(path: Path, image: np.ndarray) -> None:
    Image.fromarray((255 * np.clip(image, 0, 1)).astype(np.uint8)).resize(
        (4 * WIDTH, 4 * HEIGHT), Image.Resampling.NEAREST
    ).save(path)


def test_a_box_among_splats_is_drawn_like_python(
    page: Any, site: pages.WebSite, folder: Path, renderer: Renderer, tmp_path: Path
) -> None:
    document = {
        "models": ["knot.ply"],
        "meshes": [{"path": "box.glb", "rotate": {"axis": [1, 2, 3], "degrees": 40}}],
        "background": [0.1, 0.2, 0.3],
        "camera": _EYES[0],
        "fov": 40,
    }
    result = shown(site, document)
    assert result["errors"] == result["warnings"] == []
    [expected] = rendered(folder, document, renderer)
    actual = picture(page)
    save(tmp_path / "page.png", actual)
    save(tmp_path / "python.png", expected)
    print(decibels(actual, expected), np.abs(actual - expected).max(axis=2).round(2).max())
    assert decibels(actual, expected) >= _WHOLE
