"""Files that a page draws while they arrive, from a server that holds back most of each."""

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import Splats, open_splats, write_compressed_ply, write_ply, write_splat
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from support.browser import GatedBytes
from support.splat_files import ksplat
from support.tiles.builds import SMALL, build
from support.tiles.level_scenes import knot
from support.web.pages import WebSite, float32_result

pytestmark = pytest.mark.slow

_SHARE = 0.2
_GAUSSIANS = 20_000
_ELEMENT = "document.querySelector('gsgen-model')"


def _written(write: Callable[..., None]) -> Callable[[Path, Splats], None]:
    return lambda path, splats: write(path, splats)


_FORMATS: dict[str, tuple[Callable[[Path, Splats], Any], int]] = {
    # What writes a file, and its degree.
    "plain.ply": (_written(write_ply), 1),
    "packed.compressed.ply": (_written(write_compressed_ply), 1),
    "plain.splat": (_written(write_splat), 0),
    "plain.ksplat": (lambda path, splats: path.write_bytes(ksplat(splats, 0)), 1),
}


def element_page(site: WebSite, source: str) -> Any:
    """Open a page with one element, and return it."""
    site.contents["/loading.html"] = f"""<!doctype html><meta charset=utf-8>
      <style>gsgen-model {{ width: 96px; height: 72px; aspect-ratio: auto }}</style>
      <script type=module src=/client/gsgen.js></script>
      <gsgen-model src="{source}"></gsgen-model>""".encode()
    site.open("/loading.html")
    return site.page


def lit_share(page: Any) -> float:
    """Return the share of pixels of the element, as the screen shows it, that are not black."""
    picture = Image.open(io.BytesIO(page.locator("gsgen-model").screenshot()))
    return float((np.asarray(picture.convert("L")) > 30).mean())


def wait_for_light(page: Any) -> float:
    for _ in range(600):
        share = lit_share(page)
        if share > 0.02:
            return share
        page.wait_for_timeout(100)
    return 0.0


@pytest.mark.parametrize("name", _FORMATS)
def test_rows_are_drawn_while_they_arrive(
    name: str, site: WebSite, renderer: Renderer, tmp_path: Path
) -> None:
    """The first picture needs a fifth of the bytes; the last one is Python's."""
    write, degree = _FORMATS[name]
    path = tmp_path / name
    write(path, torus_knot(_GAUSSIANS, degree=degree))
    content = GatedBytes.of(path.read_bytes(), _SHARE)
    site.contents[f"/{name}"] = content
    page = element_page(site, name)
    assert wait_for_light(page) > 0.02
    assert content.sent <= 0.25 * len(content)
    assert page.evaluate(f"{_ELEMENT}.state") == "loading"
    assert page.evaluate(f"{_ELEMENT}._shown.model.buffers.count") < _GAUSSIANS / 2
    content.gate.set()
    page.evaluate(f"{_ELEMENT}.ready.then(() => null)")
    assert page.evaluate(f"{_ELEMENT}._shown.model.buffers.count") == _GAUSSIANS
    image, camera = whole_picture(page)
    splats = open_splats(path)
    assert isinstance(splats, Splats)
    drawing = renderer.draw(Scene([SplatData.from_splats(splats)]), camera)
    expected = renderer.device.read(drawing.image, np.float32, image.size).reshape(image.shape)
    assert (expected[..., 3] > 0.5).mean() > 0.05
    assert psnr(image, expected) >= 90


def whole_picture(page: Any) -> tuple[np.ndarray, Camera]:
    """Return the picture of an element whose file has arrived, and its camera."""
    numbers = float32_result(
        page,
        """async () => {
          const { _shown: shown, _look: look } = document.querySelector("gsgen-model");
          const camera = shown.orbit.camera(96, 72);
          await shown.renderer.drawWhole(camera);
          window.drawn = camera;
          return shown.renderer.readImage("color");
        }""",
    )
    camera = page.evaluate("drawn")
    lens = {name: camera[name] for name in ("fx", "fy", "cx", "cy", "width", "height", "near")}
    view = np.reshape(camera["view"], (4, 4))
    return numbers.reshape(72, 96, 4), Camera(view=view, **lens)


def test_the_first_picture_of_a_tileset_needs_few_tiles(site: WebSite, tmp_path: Path) -> None:
    """The coarsest one; the picture before it stays until it is there."""
    write_ply(tmp_path / "knot.ply", knot(12_000, degree=1))
    build([tmp_path / "knot.ply"], tmp_path / "tiles", replace(SMALL, leaf=900))
    finer, total = [], 0
    for path in filter(Path.is_file, (tmp_path / "tiles").rglob("*")):
        name = path.relative_to(tmp_path / "tiles").as_posix()
        content = path.read_bytes()
        total += len(content)
        if path.suffix == ".glb" and path.parent.name != "0":
            content = GatedBytes.of(content, 0)
            finer.append(content)
        site.contents[f"/few/{name}"] = content
    page = element_page(site, "/few/tileset.json")
    assert wait_for_light(page) > 0.02
    sent = total - sum(len(content) - content.sent for content in finer)
    assert len(finer) > 3
    assert sent <= 0.25 * total
    for content in finer:
        content.gate.set()
