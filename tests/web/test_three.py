"""Gaussians in scenes of three.js, at both ends of the range of versions."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import Splats, write_spz
from support.browser import serving
from support.commands import ROOT
from support.web.packages import package
from support.web.pages import CLIENT

VERSIONS = ("three-0.180.0", "three-0.187.0")
_EXAMPLE = ROOT / "docs/examples/three"
_C0 = 0.28209479177387814

# A white Gaussian at depth 10, a red plane before its left half, a blue one behind it, and a green
# pane before its upper half.
_PLANES = """async () => {
  const { THREE, GsgenObject, compositor } = window;
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(60, 2, 0.1, 100);
  camera.position.z = 10;
  const plane = (color, x, y, z, side, options = {}) => {
    const material = new THREE.MeshBasicMaterial({ color, ...options });
    const mesh = new THREE.Mesh(new THREE.PlaneGeometry(side, side), material);
    mesh.position.set(x, y, z);
    scene.add(mesh);
  };
  plane(0xff0000, -4, 0, 2, 8);
  plane(0x0000ff, 0, 0, -3, 60);
  plane(0x00ff00, 0, 4, 4, 8, { transparent: true, opacity: 0.5 });
  scene.add(await GsgenObject.load("white.spz"));
  await compositor.render(scene, camera);
  return [...await compositor.gaussians.readImage("color")];
}"""


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A large white Gaussian, and a standing ellipsoid of some in place of a person."""
    folder = tmp_path_factory.mktemp("models")
    rng = np.random.default_rng(0)
    position = rng.normal(size=(300, 3)) * [0.2, 0.8, 0.2]
    counts = {"white.spz": np.zeros((1, 3)), "person.spz": position}
    for name, centers in counts.items():
        count, scale = len(centers), np.log(0.08 if len(centers) > 1 else 4.0)
        splats = Splats(
            position=centers.astype(np.float32),
            rotation=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
            log_scale=np.full((count, 3), scale, np.float32),
            logit_opacity=np.full(count, 6, np.float32),
            sh=np.full((count, 1, 3), 0.5 / _C0, np.float32),
        )
        write_spz(folder / name, splats)
    return {name: (folder / name).read_bytes() for name in counts}


@pytest.fixture(scope="module", params=VERSIONS)
def page(browser: Any, request: Any, models: dict[str, bytes]) -> Iterator[Any]:
    """The example's page, with its first frame drawn."""
    folders = {"gsgen": CLIENT, "three": package(request.param)}
    contents: dict[str, bytes] = {f"/{name}": data for name, data in models.items()}
    for path in _EXAMPLE.iterdir():
        contents[f"/{path.name}"] = path.read_bytes()
    with serving(folders, contents) as address:
        context = browser.new_context(
            viewport={"width": 160, "height": 80}, reduced_motion="reduce"
        )
        page = context.new_page()
        page.set_default_timeout(240_000)
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda line: errors.append(line.text) if line.type == "error" else None)
        page.goto(f"{address}/index.html?src=person.spz")
        page.wait_for_function("window.isDrawn")
        assert [text for text in errors if "404" not in text] == []
        yield page
        context.close()


def test_surfaces_hide_gaussians_and_are_hidden(page: Any) -> None:
    """Each corner of the image against the blend of its surfaces, front to back."""
    image = np.array(page.evaluate(_PLANES)).reshape(80, 160, 4)
    red, green, blue, white = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    deviation = 4 / 10 * 40 / np.tan(np.pi / 6)  # of the Gaussian in the image, pixels

    def behind(row: int, column: int) -> np.ndarray:
        square = (row + 0.5 - 40) ** 2 + (column + 0.5 - 80) ** 2
        alpha = np.exp(-0.5 * square / deviation**2) / (1 + np.exp(-6))
        return alpha * white + (1 - alpha) * blue

    expected = {
        (50, 75): red,
        (50, 85): behind(50, 85),
        (30, 75): 0.5 * green + 0.5 * red,
        (30, 85): 0.5 * green + 0.5 * behind(30, 85),
    }
    for pixel, color in expected.items():
        np.testing.assert_allclose(image[pixel][:3], color, atol=0.03, err_msg=str(pixel))
        np.testing.assert_allclose(image[pixel][3], 1, atol=1e-3)


def test_the_example_has_shadows_and_a_person(page: Any, tmp_path: Path) -> None:
    """See the picture with --basetemp."""
    # three.js draws the shadows of a light once in a frame of the browser.
    script = """async (hidden) => {
      for (const name of hidden) window[name].castShadow = false;
      for (let frame = 0; frame < 2; frame++) await new Promise(requestAnimationFrame);
      await draw(0);
      return [...await compositor.gaussians.readImage("color")];
    }"""
    images = [
        np.array(page.evaluate(script, hidden)).reshape(80, 160, 4)[..., :3]
        for hidden in ([], ["proxy"], ["box"])
    ]
    picture = (255 * np.clip(images[0], 0, 1)).astype(np.uint8)
    Image.fromarray(picture).save(tmp_path / "scene.png")
    lit = [np.subtract(images[i + 1], images[i]).max(axis=2) > 0.05 for i in range(2)]
    assert all(part.mean() > 0.002 for part in lit)  # the ground without shadows is brighter
    white = (images[0] > 0.8).all(axis=2)
    assert white[20:60, 70:90].any()  # the person stands in the middle
