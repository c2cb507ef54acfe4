"""Browsers without WebGPU: three.js draws the element by WebGL 2."""

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.formats import open_splats, write_ply
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.baking import bake
from gsgen.runtime.checks.level import scene_of
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.playback.scene_camera import scene_viewpoint
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.scene_file import open_scene, read_scene
from gsgen.sdk.binding import FrameSession
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.streaming.tiles_source import open_stream
from support.tiles.builds import SMALL, build
from support.web.without_webgpu import (
    element_picture,
    frame_picture,
    frames_page,
    page_of,
    page_without_webgpu,
    python_picture,
)

pytestmark = pytest.mark.slow

_ELEMENT = "document.querySelector('gsgen-model')"
_SHARES = (0.0, 0.3, 0.7)
_WIDTH, _HEIGHT = 200, 150  # of elements
_SCENE = {
    "models": [
        "knot.ply",
        {
            "path": "knot.ply",
            "translate": [1.5, 0.5, 1],
            "rotate": {"axis": [1, 2, 3], "degrees": 40},
            "scale": [0.6, 0.8, 0.5],
            "opacity_scale": 0.7,
            "antialias": "mip",
            "clip": {"low": [-9, -0.5, -9], "high": [9, 9, 0.3]},
        },
        {
            "path": "walk.onnx",
            "translate": [-1.5, 0, -1],
            "inputs": {"time": {"keys": [{"at": 0, "value": 0.1}, {"at": 2, "value": 0.7}]}},
        },
        {
            "path": "tiles/tileset.json",
            "translate": [-1, 1.5, 1],
            "scale": 0.6,
            "opacity_scale": 0.8,
        },
    ],
    "camera": {
        "keys": [
            {"at": 0, "value": "look-at:0.4,-1.2,-7,0,0,0"},
            {"at": 2, "value": "look-at:3,-1,-6,0.2,0,0"},
        ]
    },
    "background": [0.1, 0.2, 0.3],
    "fov": 40,
}
_DECIBELS = 32  # three.js stores colours in bytes, widens each Gaussian, and sorts into 4,096 bins


@pytest.fixture(scope="module")
def knot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("knot") / "knot.ply"
    write_ply(path, torus_knot(600, degree=3))
    build([path], path.parent / "tiles", replace(SMALL, leaf=200))
    return path


@pytest.fixture(scope="module")
def page(
    ort_folder: Path, knot: Path, walking_person: bytes, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Any, str]]:
    contents = {"/knot.ply": knot.read_bytes(), "/walk.onnx": walking_person}
    contents["/meshes.json"] = b'{"gsgen_scene": "1.0", "models": [], "meshes": ["box.obj"]}'
    contents["/scene.json"] = json.dumps(_SCENE).encode()
    for file in sorted((knot.parent / "tiles").rglob("*")):
        if file.is_file():
            contents[f"/{file.relative_to(knot.parent).as_posix()}"] = file.read_bytes()
    contents["/none.html"] = b"<!doctype html>"
    path = tmp_path_factory.mktemp("walk") / "walk.onnx"
    path.write_bytes(walking_person)
    for number, share in enumerate(_SHARES):
        bake(path, path.with_name("frame.ply"), time=share)
        contents[f"/{number}.ply"] = path.with_name("frame.ply").read_bytes()
    frames_page(contents)
    poster = "poster='data:image/gif;base64,R0lGODlhAQABAAAAACw='"
    for name, element in {
        "knot": "<gsgen-model src=/knot.ply alt=Knot></gsgen-model>",
        "walk": "<gsgen-model src=/walk.onnx></gsgen-model>",
        "tileset": "<gsgen-model src=/tiles/tileset.json></gsgen-model>",
        "scene": "<gsgen-scene src=/scene.json></gsgen-scene>",
        "meshes": "<gsgen-model src=/meshes.json></gsgen-model>",
        "depth": "<gsgen-model src=/knot.ply mode=depth></gsgen-model>",
    }.items():
        contents[f"/{name}.html"] = page_of(element)
    alone = f"<gsgen-model src=/knot.ply {poster}></gsgen-model>"
    no_gpu = "<script>delete Navigator.prototype.gpu</script>"  # and elsewhere only no adapter
    contents["/alone.html"] = page_of(no_gpu + alone, has_three=False)
    with page_without_webgpu(contents, ort_folder) as (page, address):
        yield page, address


def opened(page: tuple[Any, str], name: str) -> Any:
    browser_page, address = page
    browser_page.goto(f"{address}/{name}.html")
    browser_page.wait_for_function(f"{_ELEMENT}.report")
    return browser_page


def scene_of_splats(path: Path) -> Scene:
    return Scene([SplatData.from_splats(open_splats(path))])


def errors_of(page: Any) -> list[dict[str, str]]:
    return list(page.evaluate(f"{_ELEMENT}.report.errors"))


def test_a_splat_file_is_drawn_like_in_python_and_told(page: tuple[Any, str], knot: Path) -> None:
    shown = opened(page, "knot")
    assert errors_of(shown) == []
    image, camera = element_picture(shown)
    expected = python_picture(scene_of_splats(knot), camera)
    assert (expected > 0.2).mean() > 0.02
    assert psnr(image, expected) >= _DECIBELS
    assert shown.evaluate(f"{_ELEMENT}.report.renderedBy") == "webgl2"
    status = f"{_ELEMENT}.shadowRoot.querySelector('[role=status]').textContent"
    assert shown.evaluate(status) == "Loaded without WebGPU: Knot"
    # The first picture after a turn is drawn in the order of the new camera.
    shown.evaluate(f"{_ELEMENT}.orbit = {{ azimuth: 31 }}")
    turned, camera = element_picture(shown)
    assert psnr(turned, python_picture(scene_of_splats(knot), camera)) >= _DECIBELS


def test_a_generator_is_drawn_like_in_python_and_plays(
    page: tuple[Any, str], walking_person: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "walk.onnx"
    path.write_bytes(walking_person)
    shown = opened(page, "walk")
    assert errors_of(shown) == []
    pictures = []
    with FrameSession(path, provider="cpu") as session:
        assert isinstance(session.manifest, GeneratorManifest)
        for time in _SHARES:
            image, camera = element_picture(shown, time)
            outputs = session.run({"time": time}, copy=True)
            scene = scene_of(session.manifest, {name: outputs[name] for name in outputs})
            assert psnr(image, python_picture(scene, camera)) >= _DECIBELS
            pictures.append(image)
    assert all(psnr(a, b) < 30 for a, b in pairwise(pictures))
    shown.evaluate(f"{_ELEMENT}.currentTime = 0; {_ELEMENT}.play(); null")
    shown.wait_for_function(f"{_ELEMENT}.currentTime > 0.2")


def test_a_frame_in_three_is_as_good_as_its_baked_file(
    page: tuple[Any, str], walking_person: bytes, tmp_path: Path
) -> None:
    """Three times, beside what three's own loader shows of the baked PLY."""
    path = tmp_path / "walk.onnx"
    path.write_bytes(walking_person)
    shown, address = page
    shown.goto(f"{address}/frames.html?webgl&provider=wasm")
    shown.wait_for_function("window.walkTo")
    with FrameSession(path, provider="cpu") as session:
        assert isinstance(session.manifest, GeneratorManifest)
        for number, share in enumerate(_SHARES):
            outputs = session.run({"time": share}, copy=True)
            scene = scene_of(session.manifest, {name: outputs[name] for name in outputs})
            image, camera = frame_picture(shown, share)
            baked, _ = frame_picture(shown, share, f"/{number}.ply")
            expected = python_picture(scene, camera)
            assert (expected > 0.2).mean() > 0.01
            assert psnr(image, expected) >= psnr(baked, expected) - 1
            assert psnr(baked, image) > 35


def settled_picture(page: Any, name: str, time: float | None = None) -> np.ndarray:
    """Return an element's picture when no tile that its camera needs is missing."""
    selector = f"document.querySelector('{name}')"
    loading = f"{selector}._shown.model.loading"
    if name == "gsgen-scene":
        loading = (
            f"{selector}.stage.entries.reduce((sum, {{ model }}) => sum + (model.loading ?? 0), 0)"
        )
    if time is not None:
        page.evaluate(f"{selector}.currentTime = {time}; null")
    while True:
        image, _ = element_picture(page, name=name)
        if not page.evaluate(loading):
            return image
        page.wait_for_function(f"{loading} === 0")


def test_a_scene_of_models_and_tilesets_is_drawn_like_in_python_at_three_times(
    page: tuple[Any, str], knot: Path, walking_person: bytes
) -> None:
    path = knot.with_name("scene.json")
    path.write_text(json.dumps(_SCENE), "utf-8")
    knot.with_name("walk.onnx").write_bytes(walking_person)
    scene = read_scene(path)
    sources = open_scene(scene, stream=open_stream)
    view = scene_viewpoint([scene], None, _WIDTH, _HEIGHT, None, None)
    sequence = FrameSequence(
        sources, view, background=scene.background or (0, 0, 0, 1), frames=3, renderer=Renderer()
    )
    browser_page, address = page
    browser_page.goto(f"{address}/scene.html")
    browser_page.wait_for_function("document.querySelector('gsgen-scene')?.report")
    assert browser_page.evaluate("document.querySelector('gsgen-scene').report.errors") == []
    pictures = []
    for frame in range(3):
        expected = np.clip(sequence.draw(frame).rgba[..., :3], 0, 1)
        pictures.append(settled_picture(browser_page, "gsgen-scene", float(frame)))
        assert psnr(pictures[-1], expected) >= _DECIBELS
    for source in sources:
        source.close()
    assert all(psnr(a, b) < 30 for a, b in pairwise(pictures))
    browser_page.evaluate("document.querySelector('gsgen-scene').currentTime = 0; null")
    browser_page.evaluate("document.querySelector('gsgen-scene').play(); null")
    browser_page.wait_for_function("document.querySelector('gsgen-scene').currentTime > 0.2")


def test_a_tileset_is_drawn_like_the_scene_that_it_was_built_from(
    page: tuple[Any, str], knot: Path
) -> None:
    shown = opened(page, "tileset")
    assert errors_of(shown) == []
    shown.evaluate(f"{_ELEMENT}.maxError = 0.001; null")
    shown.wait_for_function(f"{_ELEMENT}.state === 'ready'")
    image = settled_picture(shown, "gsgen-model")
    _, camera = element_picture(shown)
    store, index = open_store(knot.parent / "tiles")
    frame = load_tileset(store, index).transform
    scene = Scene([SplatSet(SplatData.from_splats(open_splats(knot)), frame)])
    assert psnr(image, python_picture(scene, camera)) >= _DECIBELS


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("depth", "mode: is depth, expected color in a browser without WebGPU"),
        ("meshes", "meshes: are drawn by WebGPU, which this browser lacks"),
    ],
)
def test_what_webgl_lacks_is_an_error(name: str, message: str, page: tuple[Any, str]) -> None:
    [error] = errors_of(opened(page, name))
    assert error["message"] == message


def test_without_three_the_poster_stays_with_one_sentence(page: tuple[Any, str]) -> None:
    shown = opened(page, "alone")
    [error] = errors_of(shown)
    assert error["message"].startswith("this browser has no WebGPU, and three.js cannot be loaded")
    assert "import map" in error["hint"]
    assert not shown.evaluate(f"{_ELEMENT}.shadowRoot.querySelector('img').hidden")
