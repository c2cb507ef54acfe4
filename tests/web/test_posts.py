"""Post-process models in pages, beside `gsgen render` with the same models."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.arrays import f32
from gsgen.conformance.fixtures.builders.images import darken
from gsgen.formats import write_ply
from gsgen.reference_plugins.images.synthetic_images import write_denoiser, write_stylise
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.playback.post_process import open_posts
from gsgen.runtime.playback.scene_camera import scene_viewpoint
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.sources.scene_file import open_scene, read_scene
from support.commands import gsgen_here
from support.web.pages import WebSite, float32_result

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("ort")]

_WIDTH, _HEIGHT = 40, 28
_PAGE = f"""<!doctype html><meta charset=utf-8>
  <style>gsgen-scene, gsgen-model {{ width: {_WIDTH}px; height: {_HEIGHT}px; aspect-ratio: auto }}</style>
  <script type=module src=/client/scene.js></script><body></body>""".encode()
_LEAST_DECIBELS = 60
_SMALL_UNET = {
    "block_out_channels": [8],
    "down_block_types": ["DownBlock2D"],
    "up_block_types": ["UpBlock2D"],
}
_ATTENDING = {"block_out_channels": [8, 8]}
_LATENT = {"unet": _SMALL_UNET, "latent": True}
_EXPORTS: dict[str, tuple[str, dict[str, Any], list[str]]] = {
    "stylise": ("stylise", {"channels": 4, "blocks": 1}, ["--size", "any"]),
    "stylise-tiles": ("stylise", {"channels": 4, "blocks": 1}, ["--size", "25x17", "--no-slider"]),
    "stylise-larger": ("stylise", {"channels": 4, "blocks": 0}, ["--size", "30x36"]),
    "denoiser": ("denoiser", {"unet": _ATTENDING}, ["--size", "any"]),
    "denoiser-unit": (
        "denoiser",
        {"unet": _SMALL_UNET},
        ["--size", "40x28", "--timestep-input", "--values", "unit"],
    ),
    "denoiser-latent": ("denoiser", _LATENT, ["--size", "40x28", "--result", "network"]),
}
"""The plugin, the options of its checkpoint and of its export."""


def exported(name: str, folder: Path) -> Path:
    plugin, checkpoint, options = _EXPORTS[name]
    write = {"stylise": write_stylise, "denoiser": write_denoiser}[plugin]
    write(folder / name, **checkpoint)
    target = folder / f"{name}.onnx"
    command = ("export", plugin, "--checkpoint", str(folder / name), *options, "-o", str(target))
    result = gsgen_here(*command)
    assert result.code == 0, result.err
    return target


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("posts")
    write_ply(folder / "knot.ply", torus_knot(500, degree=1))
    return folder


@pytest.fixture(scope="module")
def page(site: WebSite, folder: Path) -> Iterator[Any]:
    site.contents["/knot.ply"] = (folder / "knot.ply").read_bytes()
    site.contents["/posts.html"] = _PAGE
    site.open("/posts.html")
    site.page.wait_for_function("Boolean(customElements.get('gsgen-scene'))")
    yield site.page
    site.open()


def shown(site: WebSite, document: dict[str, Any]) -> list[dict[str, str]]:
    """Show a scene file in a new element until its posts are opened; return its warnings."""
    site.contents["/scene.json"] = json.dumps(document).encode()
    script = """async () => {
      document.body.replaceChildren();
      const scene = document.createElement("gsgen-scene");
      scene.src = `/scene.json?${Math.random()}`;
      document.body.append(scene);
      await scene.ready;
      await scene._shown._opening;
      return scene.warnings;
    }"""
    return list(site.page.evaluate(script))


def picture(page: Any, seconds: float = 0.0) -> np.ndarray:
    """Return what comes of the element's picture at a time: premultiplied colours and alpha."""
    script = """async ([seconds, width, height]) => {
      const { readBuffer } = await import("/client/gpu_buffers.js");
      const scene = document.querySelector("gsgen-scene, gsgen-model");
      if (seconds) scene.currentTime = seconds;
      const { _shown: shown } = scene;
      return shown._aside(async (renderer) => {
        shown.isStale = true;
        const camera = shown.orbit.camera(width, height);
        await shown._drawWith(renderer, camera, scene._look(), { isWhole: true });
        const { image, backgroundAlpha } = await shown._process(renderer, camera, scene._look());
        const numbers = await readBuffer(shown.kernels.device, image, Float32Array, 4 * width * height);
        for (let i = 3; i < numbers.length; i += 4) numbers[i] += (1 - numbers[i]) * backgroundAlpha;
        return numbers;
      });
    }"""
    return float32_result(page, script, [seconds, _WIDTH, _HEIGHT]).reshape(_HEIGHT, _WIDTH, 4)


def rendered(
    folder: Path, document: dict[str, Any], renderer: Renderer, frames: int = 1
) -> list[Frame]:
    """Return the frames that `gsgen render` draws of a scene file."""
    path = folder / "scene.json"
    path.write_text(json.dumps(document), "utf-8")
    scene = read_scene(path)
    sources, posts = open_scene(scene), open_posts(scene)
    view = scene_viewpoint([scene], None, _WIDTH, _HEIGHT, None, None)
    sequence = FrameSequence(
        sources,
        view,
        background=scene.background or (0, 0, 0, 1),
        frames=frames,
        post=posts,
        renderer=renderer,
    )
    images = [sequence.draw(number) for number in range(frames)]
    for opened in (*sources, *posts):
        opened.close()
    return images


def decibels(first: np.ndarray, second: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(first - second).mean() + 1e-20))


def scene_of(*posts: object, **fields: object) -> dict[str, Any]:
    view = {"camera": "look-at:0.4,-1.2,-7,0,0,0", "fov": 40, "background": [0.1, 0.2, 0.3]}
    return {"models": ["knot.ply"], "posts": list(posts), **view, **fields}


# At night, too, two whose size and values others have: of a fixed size, and with a timestep.
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            n, marks=[pytest.mark.nightly] if n in ("stylise-larger", "denoiser-unit") else []
        )
        for n in _EXPORTS
    ],
)
def test_every_export_changes_the_picture_as_python_does(
    name: str, page: Any, site: WebSite, folder: Path, renderer: Renderer
) -> None:
    path = exported(name, folder)
    site.contents[f"/{path.name}"] = path.read_bytes()
    document = scene_of(path.name, background=[0.1, 0.2, 0.3, 0.5])
    assert shown(site, document) == []
    [expected] = rendered(folder, document, renderer)
    [plain] = rendered(folder, document | {"posts": []}, renderer)
    actual = picture(page)
    posts = "document.querySelector('gsgen-scene')._shown._posts"
    assert page.evaluate(f"{posts}._models.every(({{ _session }}) => _session.isCaptured)")
    assert decibels(plain.rgba, expected.rgba) < 40
    assert decibels(actual, expected.rgba) >= _LEAST_DECIBELS


@pytest.fixture(scope="module")
def steps(folder: Path, site: WebSite) -> str:
    """A model with inputs and one that halves colours, in tiles of 8 × 12; return its path."""
    for name in ("one_step_enhancer", "post_process_any_size"):
        find(name).write(folder)
        site.contents[f"/{name}.onnx"] = (folder / f"{name}.onnx").read_bytes()
    return "one_step_enhancer.onnx"


def test_models_run_in_order_with_inputs_and_key_frames(
    page: Any, site: WebSite, folder: Path, renderer: Renderer, steps: str
) -> None:
    keys = {"keys": [{"at": 0, "value": 0.001}, {"at": 2, "value": 0.02, "easing": "hold"}]}
    document = scene_of(
        {"path": steps, "inputs": {"strength": keys, "timestep": 250}}, "post_process_any_size.onnx"
    )
    assert shown(site, document) == []
    images = rendered(folder, document, renderer, frames=3)
    assert np.abs(images[0].rgba - images[1].rgba).max() > 0.03
    for seconds, expected in zip((0, 1, 2), images, strict=True):
        assert decibels(picture(page, seconds), expected.rgba) >= _LEAST_DECIBELS
    # What the element is told wins over key frames, and not over numbers of the file.
    page.evaluate(
        "document.querySelector('gsgen-scene').inputs = { strength: 0.002, timestep: 900 }"
    )
    document["posts"][0]["inputs"]["strength"] = 0.002
    [expected] = rendered(folder, document, renderer)
    assert decibels(picture(page, 1), expected.rgba) >= _LEAST_DECIBELS


_FAULTS: dict[str, tuple[object, str]] = {
    "missing": ("gone.onnx", "gone.onnx: cannot be loaded: 404"),
    "generator": ("drift.onnx", "is a gaussian-generator, expected a post-process Show it by"),
    "no model": ("knot.ply", "posts[0]: is not a whole ONNX file"),
    "input": (
        {"path": "one_step_enhancer.onnx", "inputs": {"strngth": 1}},
        "posts[0].inputs.strngth: is no input of the model Is strength meant?",
    ),
    "value": (
        {"path": "one_step_enhancer.onnx", "inputs": {"strength": [1, 2]}},
        "input strength: is [1,2], expected 1 finite numbers",
    ),
    "float16": ("post_process_half.onnx", "computes in float16, which this graphics device does"),
    "not finite": ("nan.onnx", "posts[0]: returned 3360 numbers that are not finite"),
}


@pytest.mark.parametrize("fault", _FAULTS)
def test_a_model_that_fails_leaves_the_plain_picture(
    fault: str, page: Any, site: WebSite, folder: Path, renderer: Renderer, steps: str
) -> None:
    post, message = _FAULTS[fault]
    for name in ("drift", "post_process_half"):
        site.contents[f"/{name}.onnx"] = find(name).write(folder).read_bytes()
    darken("height,width").with_weights(amount=f32(np.nan)).write(folder / "nan.onnx")
    site.contents["/nan.onnx"] = (folder / "nan.onnx").read_bytes()
    document = scene_of()
    shown(site, document | {"posts": [post]})
    [expected] = rendered(folder, document, renderer)
    assert decibels(picture(page), expected.rgba) >= 90
    [warning] = page.evaluate("document.querySelector('gsgen-scene').warnings")
    assert warning["where"] == "posts"
    assert message in warning["message"]
    assert page.evaluate("document.querySelector('gsgen-scene').state") == "ready"


def test_an_element_is_plain_while_it_moves_and_processed_when_it_is_still(
    page: Any, steps: str
) -> None:
    """By its attribute; what a scene writes of itself has the models."""
    result = page.evaluate(
        """async () => {
          document.body.innerHTML = `<gsgen-scene posts="/post_process_any_size.onnx">
            <gsgen-model src=/knot.ply></gsgen-model></gsgen-scene>`;
          const scene = document.querySelector("gsgen-scene");
          const until = async (condition) => { while (!condition()) await new Promise((resolve) => setTimeout(resolve, 5)); };
          await scene.ready;
          const shown = scene._shown;
          await until(() => shown._processed);
          const still = await (await scene.toBlob()).arrayBuffer();
          const frames = [];
          const present = scene._present.bind(scene);
          scene._present = (look) => (frames.push([Boolean(shown._processed), shown.camera.width]), present(look));
          for (let turn = 0; turn < 5; turn++) {
            scene.orbit = { azimuth: 30 + turn };
            const count = frames.length;
            await until(() => frames.length > count);
          }
          const moving = frames.splice(0);
          await until(() => shown._processed);
          await new Promise((resolve) => setTimeout(resolve, 500));
          const end = frames.splice(0);
          const written = JSON.parse(JSON.stringify(scene));
          scene.removeAttribute("posts");
          await until(() => !shown._posts);
          const plain = await (await scene.toBlob()).arrayBuffer();
          return { moving, end, posts: written.posts, differs: still.byteLength !== plain.byteLength };
        }"""
    )
    assert [is_processed for is_processed, _ in result["moving"]] == [False] * 5
    assert result["end"] == [[True, _WIDTH]]
    assert result["posts"] == ["/post_process_any_size.onnx"]
    assert result["differs"]


def test_an_element_that_plays_slowly_has_fewer_pixels_until_it_is_still(page: Any) -> None:
    """Unless its attribute says so; what stays is whole, and the same."""
    script = """async (least) => {
      document.body.innerHTML = `<gsgen-model src=/knot.ply ${least}></gsgen-model>`;
      const model = document.querySelector("gsgen-model");
      await model.ready;
      const until = async (condition) => { while (!condition()) await new Promise((resolve) => setTimeout(resolve, 2)); };
      const shown = model._shown;
      const first = await (await model.toBlob()).arrayBuffer();
      // A device of which a frame takes time by its pixels: 48 ms when whole.
      const { measured } = shown._governor;
      shown._governor.measured = function () {
        measured.call(this, 48 * this.scale ** 2);
      };
      const widths = [];
      for (let turn = 0; turn < 24; turn++) {
        const { camera } = shown;
        model.orbit = { azimuth: 30 + turn };
        await until(() => shown.camera !== camera);
        widths.push(shown.camera.width);
        await shown.kernels.device.queue.onSubmittedWorkDone(); // each frame is measured before the next
      }
      model.orbit = { azimuth: 30 };
      await until(() => shown.isFinal(model._look()) && !model._frameRequest && !model._isDrawing);
      const { width } = model._view.canvas;
      const last = await (await model.toBlob()).arrayBuffer();
      return { widths, width, isSame: String(new Uint8Array(first)) === String(new Uint8Array(last)) };
    }""".replace("WIDTH", str(_WIDTH))
    slow, whole = (page.evaluate(script, least) for least in ("", "min-render-scale=1"))
    assert set(slow["widths"]) == {_WIDTH, round(0.75 * _WIDTH)}  # 27 ms
    assert slow["widths"][-1] < _WIDTH
    assert set(whole["widths"]) == {_WIDTH}
    for result in (slow, whole):
        assert result["width"] == _WIDTH
        assert result["isSame"]
