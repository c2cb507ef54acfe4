"""Pages of a browser without WebGPU, with three.js beside the client."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gsgen.runtime.checks.viewer_kit import on_screen
from gsgen.runtime.oracle.render import render
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.web.onnxruntime_web import ORT_FILES
from support.browser import launched, require_chromium, serving
from support.commands import ROOT
from support.web.guide import LINES
from support.web.packages import package
from support.web.pages import CLIENT, unpacked

WEBGL_FLAGS = (
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-features=WebGPU",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)
THREE = "three-0.187.0"
IMPORT_MAP = LINES["without-webgpu"]
"""The import map that the guide shows."""

_STYLE = "<style>gsgen-model, gsgen-scene { aspect-ratio: auto; display: block; width: 200px; height: 150px }</style>"

_PICTURE = """async ([name, value]) => {
  const element = document.querySelector(name);
  await element.ready;
  if (value !== null) element.time = value;
  const bytes = new Uint8Array(await (await element.toBlob()).arrayBuffer());
  let text = "";
  for (const byte of bytes) text += String.fromCharCode(byte);
  return [btoa(text), element.camera];
}"""


def page_of(element: str, *, has_three: bool = True) -> bytes:
    """Return a page with the client, an element, and three.js in its import map."""
    head = '<!doctype html><meta charset="utf-8">' + (IMPORT_MAP if has_three else "")
    client = "<script type=module src=/gsgen/scene.js></script>"
    return f"{head}{client}{_STYLE}{element}".encode()


@contextmanager
def page_without_webgpu(contents: dict[str, bytes], ort_folder: Path) -> Iterator[tuple[Any, str]]:
    """Yield a page of a browser without WebGPU, and the address of its server."""
    contents |= {f"/gsgen/ort/{name}": (ort_folder / name).read_bytes() for name in ORT_FILES}
    folders = {"gsgen": CLIENT, "three": package(THREE)}
    with (
        launched(require_chromium(), WEBGL_FLAGS) as browser,
        serving(folders, contents) as address,
    ):
        page = browser.new_context(
            viewport={"width": 320, "height": 240}, reduced_motion="reduce"
        ).new_page()
        page.set_default_timeout(120_000)
        page.goto(f"{address}/none.html")
        assert not page.evaluate(
            "async () => navigator.gpu && (await navigator.gpu.requestAdapter())"
        )
        yield page, address


def element_picture(
    page: Any, time: float | None = None, name: str = "gsgen-model"
) -> tuple[np.ndarray, Camera]:
    """Return the picture of a page's element at a value of its time, and the camera."""
    text, camera = page.evaluate(_PICTURE, [name, time])
    image = Image.open(io.BytesIO(unpacked(text, np.uint8).tobytes()))
    names = ("fx", "fy", "cx", "cy", "width", "height", "near")
    view = np.reshape(camera["view"], (4, 4))
    lens = {name: camera[name] for name in names}
    return np.asarray(image, np.float64)[..., :3] / 255, Camera(view=view, **lens)


def python_picture(scene: Scene, camera: Camera) -> np.ndarray:
    """Return the picture of a scene by the float64 renderer, as a screen shows it."""
    return on_screen(render(scene, camera).rgba, scene)


_FRAME = """async ([share, ply]) => {
  await walkTo(share);
  let object = person.object;
  if (ply) {
    const { GaussianSplatPLYLoader } = await import("three/addons/loaders/GaussianSplatPLYLoader.js");
    const { GaussianSplat } = await import("three/addons/objects/GaussianSplat.js");
    object = new GaussianSplat(await new GaussianSplatPLYLoader().loadAsync(ply));
    up.add(object);
  }
  person.object.visible = !ply;
  renderer.setClearColor(0x000000, 1);
  renderer.render(scene, camera);
  const url = renderer.domElement.toDataURL();
  if (ply) up.remove(object);
  const elements = [camera.matrixWorldInverse, object.matrixWorld, camera.projectionMatrix];
  return [url.slice(url.indexOf(",") + 1), elements.map((matrix) => matrix.elements)];
}"""


def frames_page(contents: dict[str, bytes]) -> str:
    """Serve the example of frames in three.js, and return its path: WebGL 2 and WebAssembly."""
    contents["/frames.html"] = (ROOT / "docs/examples/three/frames.html").read_bytes()
    return "/frames.html?webgl&provider=wasm"


def frame_picture(page: Any, share: float, ply: str = "") -> tuple[np.ndarray, Camera]:
    """Return the example's picture at a share of the time, and the camera in the model's axes.

    Args:
        ply: Address of a file that three's own loader shows in place of the frame.
    """
    text, (view, world, projection) = page.evaluate(_FRAME, [share, ply])
    image = np.asarray(Image.open(io.BytesIO(unpacked(text, np.uint8).tobytes())), np.float64)
    height, width = image.shape[:2]
    view, world, projection = (np.reshape(each, (4, 4)).T for each in (view, world, projection))
    lens = {"fx": projection[0, 0] * width / 2, "fy": projection[1, 1] * height / 2}
    place = {"cx": width / 2, "cy": height / 2, "width": width, "height": height, "near": 0.001}
    camera = Camera(view=np.diag([1, -1, -1, 1]) @ view @ world, **lens, **place)
    return image[..., :3] / 255, camera
