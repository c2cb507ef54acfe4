"""Gaussians in scenes of three.js, at both ends of the range of versions."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import Splats, write_spz
from gsgen.runtime.web.onnxruntime_web import ORT_FILES
from support.browser import serving
from support.commands import ROOT
from support.web.packages import package
from support.web.pages import CLIENT, float32_result

pytestmark = pytest.mark.slow


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
  return compositor.gaussians.readImage("color");
}"""


@pytest.fixture(scope="module")
def white_gaussian(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("models") / "white.spz"
    splats = Splats(
        position=np.zeros((1, 3), np.float32),
        rotation=np.float32([[1, 0, 0, 0]]),
        log_scale=np.full((1, 3), np.log(4), np.float32),
        logit_opacity=np.full(1, 6, np.float32),
        sh=np.full((1, 1, 3), 0.5 / _C0, np.float32),
    )
    write_spz(path, splats)
    return path.read_bytes()


@pytest.fixture(scope="module", params=VERSIONS)
def page(
    browser: Any, request: Any, ort_folder: Path, walking_person: bytes, white_gaussian: bytes
) -> Iterator[Any]:
    """The example's page, with its first frame drawn."""
    folders = {"gsgen": CLIENT, "three": package(request.param)}
    contents = {f"/gsgen/ort/{name}": (ort_folder / name).read_bytes() for name in ORT_FILES}
    contents |= {"/walk.onnx": walking_person, "/white.spz": white_gaussian}
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
        page.goto(f"{address}/index.html")
        page.wait_for_function("window.person")
        assert [text for text in errors if "404" not in text] == []
        yield page
        context.close()


def test_surfaces_hide_gaussians_and_are_hidden(page: Any) -> None:
    """Each corner of the image against the blend of its surfaces, front to back."""
    image = float32_result(page, _PLANES).reshape(80, 160, 4)
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


def test_a_person_walks_and_casts_a_shadow(page: Any, tmp_path: Path) -> None:
    """Three pictures at three times: see them with --basetemp."""
    # three.js draws the shadows of a light once in a frame of the browser.
    script = """async ([share, isShadowed]) => {
      shadow.strength.value = Number(isShadowed);
      box.castShadow = isShadowed;
      for (let frame = 0; frame < 2; frame++) await new Promise(requestAnimationFrame);
      walkTo(share * person.model.time.seconds);
      await compositor.render(scene, camera);
      return compositor.gaussians.readImage("color");
    }"""

    def picture(share: float, *, has_shadows: bool = True) -> np.ndarray:
        numbers = float32_result(page, script, [share, has_shadows])
        return numbers.reshape(80, 160, 4)[..., :3]

    pictures = [picture(number / 3) for number in range(3)]
    for number, image in enumerate(pictures):
        bytes_of_image = (255 * np.clip(image, 0, 1)).astype(np.uint8)
        Image.fromarray(bytes_of_image).save(tmp_path / f"walk-{number}.png")
    shadows = [
        (picture(number / 3, has_shadows=False) - pictures[number] > 0.05).all(axis=2)
        for number in range(2)
    ]
    # 1. The ground is darker behind the person, and left of the box, which stands still.
    for shadow in shadows:
        assert shadow[48:60, 40:80].sum() > 20
        assert shadow[62:, 48:60].sum() > 5
    assert (shadows[0] ^ shadows[1])[48:60].sum() > 5
    assert (shadows[0] ^ shadows[1])[64:, :58].sum() <= 1
    # 2. The person walks: limbs move, the shirt stays in the middle.
    change = np.abs(pictures[1] - pictures[0]).max(axis=2) > 0.1
    assert (change & ~shadows[0] & ~shadows[1]).sum() > 20
    for image in pictures:
        rows, columns = np.nonzero(image[..., 2] > image[..., 0] + 0.3)
        assert len(rows) > 20
        assert 70 < columns.mean() < 90
        assert rows.mean() < 48
