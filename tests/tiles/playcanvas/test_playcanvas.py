"""PlayCanvas's engine streams what `tiles build --codec sog` writes, in a headless browser."""

import base64
import io
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import Splats, write_ply
from gsgen.runtime.scene.camera import Camera
from support.browser import GPU_FLAGS, launched, require_chromium, serving
from support.tiles.builds import build
from support.web.packages import package, require_node
from tiles.build.test_streamed_sog import STREAMED

pytestmark = pytest.mark.slow

SOURCES = Path(__file__).parents[2] / "bench/peers"
SIZE = (320, 180)
_SECONDS = 120_000  # milliseconds


def blocks() -> Splats:
    """A red block at the left of a green one, as splats that touch each other."""
    rng = np.random.default_rng(0)
    count = 20_000
    position = rng.uniform(-1, 1, (count, 3)) * [0.8, 0.8, 0.8]
    position[:, 0] += np.repeat([-1.5, 1.5], count // 2)
    colors = np.repeat([[0.9, 0.1, 0.1], [0.1, 0.9, 0.1]], count // 2, axis=0)
    return Splats(
        position=position.astype(np.float32),
        rotation=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        log_scale=np.full((count, 3), -3.0, np.float32),
        logit_opacity=np.full(count, 3.0, np.float32),
        sh=((colors - 0.5) / 0.28209479).astype(np.float32)[:, None],
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The page of the engine, bundled."""
    engine = package("playcanvas-2.23.3", needs_node=True) / "src/index.js"
    esbuild = package("frameworks") / "node_modules/esbuild/bin/esbuild"
    output = tmp_path_factory.mktemp("page") / "playcanvas.js"
    command = [require_node(), str(esbuild), "playcanvas.js", "--bundle", "--format=esm"]
    subprocess.run(
        [*command, f"--outfile={output}", f"--alias:playcanvas={engine}"],
        cwd=SOURCES,
        env={"PATH": "/usr/bin:/bin"},
        check=True,
        capture_output=True,
    )
    canvas = f'<canvas width="{SIZE[0]}" height="{SIZE[1]}"></canvas>'
    html = f'<!doctype html><div>{canvas}</div><script type="module" src="/page.js"></script>'
    return {"/page.js": output.read_bytes(), "/page.html": html.encode()}


def test_the_engine_draws_the_leaves_of_a_streamed_sog(
    page: dict[str, bytes], tmp_path: Path
) -> None:
    write_ply(tmp_path / "scene.ply", blocks())
    build([tmp_path / "scene.ply"], tmp_path / "town", STREAMED)
    view = Camera.look_at((0, 0, -5), (0, 0, 0), up=(0, -1, 0), width=SIZE[0], height=SIZE[1])
    camera = {"view": view.view.ravel().tolist(), "fy": view.fy, "height": view.height}
    words = json.dumps({"src": "/town/lod-meta.json", "camera": camera})
    with (
        serving({"town": tmp_path / "town"}, page) as address,
        launched(
            require_chromium(), GPU_FLAGS, ignore_default_args=["--enable-unsafe-swiftshader"]
        ) as browser,
    ):
        tab = browser.new_page()
        errors: list[str] = []
        asked: list[str] = []
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.on("response", lambda answer: asked.append(answer.url))
        tab.goto(f"{address}/page.html#{words}")
        tab.wait_for_function("window.bench", timeout=_SECONDS)
        for _ in range(300):  # frames until the finest level has come, and is drawn
            url = tab.evaluate("camera => bench.then(({ looked }) => looked(camera))", camera)
            picture = Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2])))
            red, green, blue = np.moveaxis(np.asarray(picture.convert("RGB")).astype(int), 2, 0)
            reds, greens = (red > 120) & (green < 90), (green > 120) & (red < 90)
            levels = {one.split("/town/")[1][0] for one in asked if one.endswith(".webp")}
            if "0" in levels and min(reds.sum(), greens.sum()) > 500:
                break
    assert not errors
    assert "0" in levels
    picture.save(tmp_path / "seen.png")
    assert min(reds.sum(), greens.sum()) > 500
    # Red at the left, green at the right, each block whole, and nothing of another colour.
    assert np.nonzero(reds)[1].max() < np.nonzero(greens)[1].min() + 3
    assert blue.max() < 120
