"""Scene files in pages: several models in one world, drawn as `gsgen render` draws them."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.conformance.viewer_kit.write import kit_cases
from gsgen.formats import write_ply, write_spz
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.web.pages import ModelView
from gsgen.runtime.web.serving import ModelServer
from support.commands import gsgen_here
from support.tiles.builds import SMALL, build
from support.web.pages import WebSite, running
from support.web.scene_pages import HEIGHT, WIDTH, decibels, picture, rendered, shown

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("ort")]

_LEAST_DECIBELS = 90
_PAGE = f"""<!doctype html><meta charset=utf-8>
  <style>gsgen-scene {{ width: {WIDTH}px; height: {HEIGHT}px; aspect-ratio: auto }}</style>
  <script type=module src=/client/scene.js></script><body></body>""".encode()
_CAMERA = Camera.look_at([0.4, -1.2, -7.0], [0, 0, 0], width=WIDTH, height=HEIGHT, fov_y=40)
_MODELS: list[Any] = [
    "knot.ply",
    {
        "path": "knot.spz",
        "translate": [1.5, 0.5, 1],
        "rotate": {"axis": [1, 2, 3], "degrees": 40},
        "scale": [0.6, 0.8, 0.5],
        "opacity_scale": 0.7,
        "sh_degree": 0,
        "antialias": "mip",
        "clip": {"low": [-9, -0.5, -9], "high": [9, 9, 0.3]},
    },
]

_GENERATORS = {"time-in-seconds", "view-row", "count-changes"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two splat files, three generators and a tileset."""
    folder = tmp_path_factory.mktemp("scene")
    write_ply(folder / "knot.ply", torus_knot(600, degree=1))
    write_spz(folder / "knot.spz", torus_knot(500, degree=1))
    build([folder / "knot.ply"], folder / "tiles", replace(SMALL, leaf=200))
    for case in kit_cases():
        if case.name in _GENERATORS:
            case.spec().write(folder / f"{case.name}.onnx")
    return folder


@pytest.fixture(scope="module")
def page(site: WebSite, folder: Path) -> Iterator[Any]:
    for path in folder.rglob("*"):
        if path.is_file():
            site.contents[f"/{path.relative_to(folder).as_posix()}"] = path.read_bytes()
    site.contents["/scenes.html"] = _PAGE
    site.open("/scenes.html")
    site.page.wait_for_function("Boolean(customElements.get('gsgen-scene'))")
    yield site.page
    site.open()


def test_a_scene_of_files_and_generators_is_drawn_like_python(
    page: Any, site: WebSite, folder: Path, renderer: Renderer
) -> None:
    document = {
        "models": [
            *_MODELS,
            {"path": "time-in-seconds.onnx", "translate": [-1.5, 0, 0], "inputs": {"time": 3.0}},
            {"path": "view-row.onnx", "rotate": [0.9, 0.1, 0.2, 0], "scale": 1.2},
        ],
        "background": [0.1, 0.2, 0.3, 1],
        "camera": json.loads(_CAMERA.to_json()),
    }
    result = shown(site, document)
    assert result["errors"] == result["warnings"] == []
    [expected] = rendered(folder, document, renderer)
    assert expected.std() > 0.05
    actual = picture(page)
    assert decibels(actual, expected) >= _LEAST_DECIBELS


def test_children_of_an_element_are_the_models_of_a_scene(
    page: Any, folder: Path, renderer: Renderer
) -> None:
    """What the page writes of it is read and drawn by Python."""
    written = page.evaluate(
        """async () => {
          document.body.innerHTML = `<gsgen-scene background="0.1 0.2 0.3" field-of-view=40>
            <gsgen-model src="/knot.ply" opacity=0.8></gsgen-model>
            <gsgen-model src="/knot.spz" position="1.5 0.5 1" rotation="0.9 0.1 0.2 0" scale=0.5></gsgen-model>
            <gsgen-model src="/time-in-seconds.onnx" position="-1.5 0 0"></gsgen-model></gsgen-scene>`;
          const scene = document.querySelector("gsgen-scene");
          scene.querySelectorAll("gsgen-model")[2].inputs = { time: 4 };
          await scene.ready;
          scene.orbit = { view: VIEW };
          while (scene._frameRequest || scene._isDrawing) await new Promise((resolve) => setTimeout(resolve, 10));
          await scene.toBlob();
          const entry = scene.stage.entries[1];
          entry.transform = entry.transform.with(3, 1.25);
          return [JSON.stringify(scene), scene.warnings];
        }""".replace("VIEW", str(_CAMERA.view.ravel().tolist()))
    )
    text, warnings = written
    document = json.loads(text)
    assert warnings == []
    for model in document["models"]:
        model["path"] = Path(model["path"]).name
    assert [model["transform"][0][3] for model in document["models"]] == [0, 1.25, -1.5]
    [expected] = rendered(folder, document, renderer)
    assert decibels(picture(page), expected) >= _LEAST_DECIBELS


def test_a_timeline_moves_cameras_and_inputs_like_python(
    page: Any, site: WebSite, folder: Path, renderer: Renderer
) -> None:
    """Two splat files, a tileset, and generators: with key frames, without, and with a camera."""
    eyes = ["look-at:0.4,-1.2,-7,0,0,0", "look-at:3,-1,-6,0.2,0,0"]
    document = {
        "models": [
            *_MODELS,
            {
                "path": "time-in-seconds.onnx",
                "translate": [-1.5, 0, 0],
                "inputs": {
                    "time": {
                        "keys": [
                            {"at": 0, "value": 3, "easing": "ease-in-out"},
                            {"at": 1.5, "value": 9},
                            {"at": 2, "value": 4},
                        ]
                    }
                },
            },
            {"path": "count-changes.onnx", "translate": [0, 1, -1]},
            {
                "path": "tiles/tileset.json",
                "translate": [-1, 1.5, 1],
                "scale": 0.6,
                "opacity_scale": 0.5,
            },
            {"path": "view-row.onnx", "rotate": [0.9, 0.1, 0.2, 0], "scale": [1.2, 1.1, 1]},
        ],
        "camera": {"keys": [{"at": 0, "value": eyes[0]}, {"at": 2, "value": eyes[1]}]},
        "fov": 40,
    }
    result = shown(site, document)
    assert result["errors"] == result["warnings"] == []
    assert result["duration"] == 2
    images = rendered(folder, document, renderer, frames=3)
    assert np.abs(images[0] - images[1]).max() > 0.2
    for seconds, expected in zip((0, 1, 2), images, strict=True):
        assert decibels(picture(page, seconds), expected) >= _LEAST_DECIBELS


def test_commands_put_a_scene_file_into_a_page(
    browser: Any, folder: Path, renderer: Renderer, ort_folder: Path, tmp_path: Path
) -> None:
    """Once served, and drawn again when a model changes; once in a file that opens from disk."""
    document = {
        "models": [
            "knot.ply",
            {"path": "time-in-seconds.onnx", "translate": [-1.5, 0, 0], "inputs": {"time": 3}},
        ],
        "background": [0.1, 0.2, 0.3],
        "camera": "look-at:0.4,-1.2,-7,0,0,0",
        "fov": 40,
    }
    for name in ("knot.ply", "time-in-seconds.onnx"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    [expected] = rendered(tmp_path, document, renderer)
    target, scene = tmp_path / "scene.html", tmp_path / "scene.json"
    result = gsgen_here("export", "html", str(scene), "-o", str(target), "--ort", str(ort_folder))
    assert result.code == 0, result.err
    context = browser.new_context(viewport={"width": 300, "height": 200})
    page = context.new_page()
    page.set_default_timeout(90_000)
    ready = "document.querySelector('gsgen-scene')?.report"
    page.goto(target.as_uri())
    page.wait_for_function(ready)
    assert page.evaluate(f"{ready}.errors") == []
    assert decibels(picture(page), expected) >= _LEAST_DECIBELS
    with running(ModelServer([scene], ModelView(play=False), ort=ort_folder)) as address:
        page.goto(address)
        page.wait_for_function(ready)
        assert page.evaluate(f"{ready}.errors") == []
        assert decibels(picture(page), expected) >= _LEAST_DECIBELS
        write_ply(tmp_path / "knot.ply", torus_knot(700, degree=0))
        page.wait_for_function(
            "document.querySelector('gsgen-scene').stage?.entries[0].model.buffers.count === 700"
        )
    context.close()
