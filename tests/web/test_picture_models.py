"""Generators of pictures in a page: picture files, as attributes and as a visitor chooses them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.feed_forward import lgm_plugin, splatter_image_plugin
from gsgen.reference_plugins.synthetic import write_lgm, write_splatter_image
from gsgen.runtime.playback.picture_inputs import picture_tracks
from gsgen.runtime.playback.player import GeneratorPlayer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.web.pages import ModelView
from gsgen.runtime.web.serving import ModelServer
from gsgen.sdk import export
from support.web.pages import float32_result, running

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("ort")]

_ELEMENT = "document.querySelector('gsgen-model')"
_LEAST_DECIBELS = 60.0


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    generator = splatter_image_plugin.build(
        write_splatter_image(folder / "run", side=32, relief=True)
    )
    path = folder / "ball.onnx"
    export(generator, path, target="webgpu", settings=Settings(level=Level.STATIC))
    return path


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A ball of another size and shape than the model's pictures, with nothing around it; a disc."""
    folder = tmp_path_factory.mktemp("files")
    paths = [folder / "a ball.png", folder / "disc.png"]
    y, x = np.mgrid[-1:1:90j, -1.4:1.4:120j]
    for path, slope in zip(paths, (0.6, 0.0), strict=True):
        pixels = np.zeros((90, 120, 4), np.uint8)
        is_inside = np.hypot(x, y) < 0.8
        light = 255 * (1 - slope * np.hypot(x, y))[is_inside]
        pixels[is_inside] = np.stack([light, 0.5 * light, 0.1 * light, 0 * light + 255], axis=1)
        Image.fromarray(pixels).save(path)
    return paths


@pytest.fixture(scope="module")
def model_of_four(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model that makes Gaussians of four pictures."""
    folder = tmp_path_factory.mktemp("four")
    path = folder / "four.onnx"
    generator = lgm_plugin.build(write_lgm(folder / "run"), 32)
    export(generator, path, target="webgpu", settings=Settings(level=Level.STATIC))
    return path


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": 300, "height": 400})
    page = context.new_page()
    page.set_default_timeout(90_000)
    yield page
    context.close()


def decibels(page: Any, model: Path, *pictures: Path) -> float:
    """Return the PSNR of the element's picture against the one that Python draws."""
    camera = page.evaluate(f"{_ELEMENT}.camera")
    width, height = camera["width"], camera["height"]
    numbers = float32_result(page, f'() => {_ELEMENT}._shown.renderer.readImage("color")')
    actual = numbers.reshape(height, width, 4)[..., :3]
    lens = {name: camera[name] for name in ("fx", "fy", "cx", "cy", "width", "height", "near")}
    view = Camera(np.reshape(camera["view"], (4, 4)), **lens)
    with GeneratorPlayer(model, background=(0.0, 0.0, 0.0, 1.0)) as player:
        (track,) = picture_tracks([*map(str, pictures)], None, [player.source])
        frame = player.render(view, values={track.input_name: track.values})
    assert frame.rgba is not None
    expected = frame.rgba[..., :3]
    assert expected.max() > 0.3
    return psnr(np.clip(actual, 0, 1), np.clip(expected, 0, 1))


def test_a_page_draws_gaussians_of_picture_files_as_python_does(
    page: Any, model: Path, pictures: list[Path], ort_folder: Path
) -> None:
    server = ModelServer([model], ModelView(), ort=ort_folder, images=pictures[:1])
    with running(server) as address:
        page.goto(address)
        page.wait_for_function(f"{_ELEMENT}.report")
        assert page.evaluate(f"{_ELEMENT}.report.errors") == []
        ratio = decibels(page, model, pictures[0])
        assert ratio >= _LEAST_DECIBELS
        # A visitor chooses another picture.
        page.set_input_files("figcaption input", str(pictures[1]))
        page.wait_for_function(f"{_ELEMENT}.state === 'loading'")
        page.wait_for_function(f"{_ELEMENT}.state === 'ready'")
        assert decibels(page, model, pictures[1]) >= _LEAST_DECIBELS


def test_a_page_draws_gaussians_of_four_pictures_as_python_does(
    page: Any, model_of_four: Path, pictures: list[Path], ort_folder: Path
) -> None:
    files = [*pictures, *reversed(pictures)]
    server = ModelServer([model_of_four], ModelView(), ort=ort_folder, images=files)
    with running(server) as address:
        page.goto(address)
        page.wait_for_function(f"{_ELEMENT}.report")
        assert page.evaluate(f"{_ELEMENT}.report.errors") == []
        assert decibels(page, model_of_four, *files) >= _LEAST_DECIBELS


def test_without_pictures_the_page_asks_for_them(
    page: Any, model: Path, pictures: list[Path], ort_folder: Path
) -> None:
    with running(ModelServer([model], ModelView(), ort=ort_folder)) as address:
        page.goto(address)
        page.wait_for_function(f"{_ELEMENT}.report")
        (error,) = page.evaluate(f"{_ELEMENT}.report.errors")
        assert "is computed from 1 picture, expected as many" in error["message"]
        assert "images=" in error["hint"]
        page.set_input_files("figcaption input", [str(path) for path in pictures])
        page.wait_for_function(f"{_ELEMENT}.report?.errors[0]?.message.includes('expected 1')")
        page.set_input_files("figcaption input", str(pictures[0]))
        page.wait_for_function(f"{_ELEMENT}.state === 'ready'")
        assert decibels(page, model, pictures[0]) >= _LEAST_DECIBELS
