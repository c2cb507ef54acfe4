"""Browsers without WebGPU: three.js draws the element by WebGL 2."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.formats import open_splats, write_ply
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.baking import bake
from gsgen.runtime.checks.level import scene_of
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.sdk.binding import FrameSession
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
_DECIBELS = 32  # three.js stores colours in bytes, widens each Gaussian, and sorts into 4,096 bins


@pytest.fixture(scope="module")
def knot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("knot") / "knot.ply"
    write_ply(path, torus_knot(600, degree=3))
    return path


@pytest.fixture(scope="module")
def page(
    ort_folder: Path, knot: Path, walking_person: bytes, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Any, str]]:
    contents = {"/knot.ply": knot.read_bytes(), "/walk.onnx": walking_person}
    contents["/tileset.json"] = b'{"asset": {"version": "1.1"}}'
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
        "tileset": "<gsgen-model src=/tileset.json></gsgen-model>",
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


def read_scene(path: Path) -> Scene:
    return Scene([SplatData.from_splats(open_splats(path))])


def errors_of(page: Any) -> list[dict[str, str]]:
    return list(page.evaluate(f"{_ELEMENT}.report.errors"))


def test_a_splat_file_is_drawn_like_in_python_and_told(page: tuple[Any, str], knot: Path) -> None:
    shown = opened(page, "knot")
    assert errors_of(shown) == []
    image, camera = element_picture(shown)
    expected = python_picture(read_scene(knot), camera)
    assert (expected > 0.2).mean() > 0.02
    assert psnr(image, expected) >= _DECIBELS
    assert shown.evaluate(f"{_ELEMENT}.report.renderedBy") == "webgl2"
    status = f"{_ELEMENT}.shadowRoot.querySelector('[role=status]').textContent"
    assert shown.evaluate(status) == "Loaded without WebGPU: Knot"
    # The first picture after a turn is drawn in the order of the new camera.
    shown.evaluate(f"{_ELEMENT}.orbit = {{ azimuth: 31 }}")
    turned, camera = element_picture(shown)
    assert psnr(turned, python_picture(read_scene(knot), camera)) >= _DECIBELS


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


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tileset", "/tileset.json: is a tileset or a scene, expected a generator or splats"),
        ("depth", "mode: is depth, expected color in a browser without WebGPU"),
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
