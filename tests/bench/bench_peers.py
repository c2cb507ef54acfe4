"""The page beside five other engines: one Chromium, the same PLY files, the same cameras.

Every engine gets a browser of its own with the same flags, on SwiftShader: ratios count, no GPU is
measured. CPU seconds are those of all processes of the browser. What a picture of a single splat
takes is code, session and the compilation of shaders by the driver; the remainder is the file.
"""

import gzip
import io
import json
import os
import re
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import open_splats, write_ply
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from support.browser import GPU_FLAGS, launched, require_chromium, serving
from support.measures import print_figure
from support.web.packages import package, require_node
from support.web.pages import CLIENT, unpacked

ENGINES = {
    "gsgen": "gsgen (WebGPU)",
    "playcanvas": "PlayCanvas",
    "babylon": "Babylon.js",
    "gaussian_splats_3d": "GaussianSplats3D",
    "spark": "Spark",
    "three": "three.js",
}
FILES = {"200k": (200_000, 3), "1m": (1_000_000, 0)}
SIZE = (640, 360)
MOVES = 6  # frames of a camera that turns
TURN = 120  # degrees
REST_SECONDS = 5
FIRST_PICTURE_BAR, MEMORY_BAR, REST_BAR = 1.5, 1.5, 0.01
ORBIT = {"azimuth": 25, "elevation": 20, "radius": 4.2, "target": [0, 0, 0], "fieldOfView": 50}
SOURCES = Path(__file__).parent / "peers"

# WebAssembly is compiled as visitors' browsers compile it: some engines sort by it.
FLAGS = tuple(flag for flag in GPU_FLAGS if not flag.startswith("--js-flags"))

_CAMERA = """async ([orbit, size]) => {
  const { OrbitCamera } = await import("/gsgen/orbit_camera.js");
  const { target, radius } = orbit;
  return new OrbitCamera({ center: target, half: target, reach: radius }, [0, -1, 0], orbit).camera(...size);
}"""

# Of the element, whose passes are cut off behind a stage.
_STAGES = """async (times) => {
  const { host } = document.querySelector("gsgen-model")._shown.renderer;
  const { device, _passes: passes } = host;
  window.stages = passes.map(({ label }) => label);
  window.drawStages = async (count) => {
    host._passes = passes.slice(0, count);
    for (let time = 0; time < times; time++) {
      const encoder = device.createCommandEncoder();
      host.encode(encoder);
      device.queue.submit([encoder.finish()]);
      await device.queue.onSubmittedWorkDone();
    }
    host._passes = passes;
  };
  return stages;
}"""


@dataclass(slots=True)
class Measured:
    """What an engine takes for a file: CPU seconds, megabytes, bytes of code, and decibels."""

    code: int = 0
    start: float = 0.0
    first: float = 0.0
    frame: float = 0.0
    rest: float = 0.0
    memory: float = 0.0
    still: float = 0.0
    turned: float = 0.0
    stages: dict[str, float] = field(default_factory=dict)


class Browser:
    """A browser whose processes are measured."""

    def __init__(self, browser: Any) -> None:
        self._session = browser.new_browser_cdp_session()
        context = browser.new_context(viewport={"width": SIZE[0], "height": SIZE[1]})
        self.page = context.new_page()
        self.page.set_default_timeout(600_000)
        self.errors: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))

    def _processes(self) -> list[dict[str, Any]]:
        return list(self._session.send("SystemInfo.getProcessInfo")["processInfo"])

    def cpu(self) -> float:
        """Return the CPU seconds of all processes until now."""
        return sum(float(process["cpuTime"]) for process in self._processes())

    def memory(self) -> float:
        """Return the megabytes of all processes after a collection of garbage, shared pages in parts."""
        session = self.page.context.new_cdp_session(self.page)
        session.send("HeapProfiler.collectGarbage")
        texts = [Path(f"/proc/{one['id']}/smaps_rollup").read_text() for one in self._processes()]
        sizes = [re.search(r"^Pss:\s+(\d+) kB", text, re.M) for text in texts]
        return sum(int(size[1]) for size in sizes if size) / 1024


@contextmanager
def opened() -> Iterator[Browser]:
    swiftshader = ["--enable-unsafe-swiftshader"]
    with launched(require_chromium(), FLAGS, ignore_default_args=swiftshader) as browser:
        yield Browser(browser)


@pytest.fixture(scope="module")
def engines(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the files that a server needs, by path: the pages, and the code of each engine."""
    modules = package("peers", needs_node=True) / "node_modules"
    esbuild = package("frameworks") / "node_modules/esbuild/bin/esbuild"
    contents = {"/blank.html": b"<!doctype html>"}
    for name in ENGINES:
        folder = tmp_path_factory.mktemp(name)
        words = ["--bundle", "--minify", "--format=esm", "--splitting", "--external:/gsgen/*"]
        subprocess.run(
            [require_node(), str(esbuild), f"{name}.js", *words, f"--outdir={folder}"],
            cwd=SOURCES,
            env={"NODE_PATH": str(modules), "PATH": "/usr/bin:/bin"},
            check=True,
            capture_output=True,
        )
        contents |= {f"/built/{name}/{path.name}": path.read_bytes() for path in folder.iterdir()}
        contents[f"/{name}.html"] = (
            '<!doctype html><meta charset="utf-8"><style>body { margin: 0 } canvas { display: block }</style>'
            f"<div><canvas width={SIZE[0]} height={SIZE[1]}></canvas></div>"
            f'<script type="module" src="/built/{name}/{name}.js"></script>'
        ).encode()
    return contents


@pytest.fixture(scope="module")
def splats(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("splats")
    paths = {}
    for name, (count, degree) in FILES.items():
        paths[name] = folder / f"{name}.ply"
        write_ply(paths[name], torus_knot(count, degree=degree))
        paths[f"{name}-single"] = folder / f"{name}-single.ply"
        write_ply(paths[f"{name}-single"], torus_knot(1, degree=degree))
    return paths


def image_of(url: str) -> np.ndarray:
    """Return the colours of a data URL, from 0 to 1."""
    data = unpacked(url[url.index(",") + 1 :], np.uint8).tobytes()
    image = Image.open(io.BytesIO(data)).convert("RGB")
    assert image.size == SIZE
    return np.asarray(image, np.float64) / 255


def camera_of(camera: dict[str, Any]) -> Camera:
    lens = {name: camera[name] for name in ("fx", "fy", "cx", "cy", "width", "height", "near")}
    return Camera(view=np.reshape(camera["view"], (4, 4)), **lens)


def cameras_of(page: Any, azimuths: list[float]) -> list[dict[str, Any]]:
    orbits = [{**ORBIT, "azimuth": azimuth} for azimuth in azimuths]
    return [{**page.evaluate(_CAMERA, [orbit, SIZE]), "orbit": orbit} for orbit in orbits]


def first_picture(browser: Browser, address: str, name: str, file: str, camera: Any) -> Any:
    """Return the CPU seconds until an engine's first picture, and the picture."""
    words = json.dumps({"src": f"/{file}.ply", "camera": camera})
    start = browser.cpu()
    browser.page.goto(f"{address}/{name}.html#{words}")
    browser.page.wait_for_function("window.bench")
    picture = browser.page.evaluate("bench.then(({ settled }) => settled())")
    return browser.cpu() - start, picture


def measured(address: str, name: str, file: str, scene: Scene, pictures: Path) -> Measured:
    result = Measured()
    with opened() as browser:
        browser.page.goto(f"{address}/blank.html")
        [camera] = cameras_of(browser.page, [25])
        result.start, _ = first_picture(browser, address, name, f"{file}-single", camera)
    with opened() as browser:
        page = browser.page
        page.goto(f"{address}/blank.html")
        moves = [25.0 + 2 * move for move in range(1, MOVES + 1)]
        camera, *moved = cameras_of(page, [25, *moves])
        [turned] = cameras_of(page, [moves[-1] + TURN])
        blank = browser.memory()
        sizes: list[int] = []
        is_code = re.compile(r"\.(m?js|wasm)$|plans\.json$").search
        page.on(
            "response",
            lambda answer: is_code(answer.url) and sizes.append(len(gzip.compress(answer.body()))),
        )
        result.first, url = first_picture(browser, address, name, file, camera)
        result.code = sum(sizes)
        renderer = Renderer()
        result.still = compared(renderer, scene, camera, url, pictures / f"{file}-{name}.png")
        page.wait_for_timeout(1000)
        result.memory = browser.memory() - blank
        start, start_time = browser.cpu(), time.monotonic()
        page.wait_for_timeout(1000 * REST_SECONDS)
        result.rest = (browser.cpu() - start) / (time.monotonic() - start_time)
        start = browser.cpu()
        page.evaluate("(cameras) => bench.then(({ moved }) => moved(cameras))", moved)
        result.frame = (browser.cpu() - start) / MOVES
        url = page.evaluate("(camera) => bench.then(({ looked }) => looked(camera))", turned)
        result.turned = compared(
            renderer, scene, turned, url, pictures / f"{file}-{name}-turned.png"
        )
        if name == "gsgen":
            result.stages = stages_of(browser)
        assert browser.errors == []
    return result


def compared(renderer: Renderer, scene: Scene, camera: Any, url: str, path: Path) -> float:
    """Return the decibels of a picture to Python's, and keep both."""
    image = image_of(url)
    expected = renderer.render(scene, camera_of(camera)).rgba[..., :3]
    both = np.concatenate([image, np.clip(expected, 0, 1)], axis=1)
    Image.fromarray((both * 255).round().astype(np.uint8)).save(path)
    return float(psnr(image, np.clip(expected, 0, 1)))


def stages_of(browser: Browser, times: int = 2) -> dict[str, float]:
    """Return the CPU seconds of each stage of a frame of the element."""
    browser.page.wait_for_timeout(500)
    stages = browser.page.evaluate(_STAGES, times)
    totals = [0.0]
    for count in range(1, len(stages) + 1):
        start = browser.cpu()
        browser.page.evaluate("(count) => drawStages(count)", count)
        totals.append((browser.cpu() - start) / times)
    return dict(zip(stages, np.diff(totals).tolist(), strict=True))


def row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def table(file: str, results: dict[str, Measured]) -> list[str]:
    """Return the table of the documentation."""
    names = ["code, KB gzip", "start, CPU s", "file, CPU s", "frame, CPU s", "at rest, CPU s/s"]
    names += ["memory, MB", "dB to Python", "dB after a turn"]
    lines = [row([file, *names]), row(["---", *["--:"] * len(names)])]
    for name, own in results.items():
        times = [own.start, own.first - own.start, own.frame]
        numbers = [f"{own.code / 1000:.0f}", *[f"{seconds:.2f}" for seconds in times]]
        numbers += [f"{own.rest:.3f}", f"{own.memory:.0f}", f"{own.still:.1f}", f"{own.turned:.1f}"]
        lines.append(row([ENGINES[name], *numbers]))
    return lines


@pytest.mark.parametrize("file", FILES)
def bench_beside_other_engines(
    file: str, engines: dict[str, bytes], splats: dict[str, Path], tmp_path: Path
) -> None:
    contents = engines | {f"/{name}.ply": path.read_bytes() for name, path in splats.items()}
    scene = Scene([SplatData.from_splats(open_splats(splats[file]))])
    with serving({"gsgen": CLIENT}, contents) as address:
        results = {}
        for name in os.environ.get("GSGEN_PEERS", " ".join(ENGINES)).split():
            results[name] = measured(address, name, file, scene, tmp_path)
            print_figure(str(results[name]))
    count, degree = FILES[file]
    for line in table(f"{count:,} of degree {degree}", results):
        print_figure(line)
    own, *peers = results.values()
    stages = ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in own.stages.items())
    print_figure(f"stages of a frame, CPU s: {stages}")
    print_figure(f"pictures beside Python's: {tmp_path}")
    for what, ratio, bar in [
        ("first picture", own.first / min(peer.first for peer in peers), FIRST_PICTURE_BAR),
        (
            "of it the file",
            (own.first - own.start) / min(peer.first - peer.start for peer in peers),
            FIRST_PICTURE_BAR,
        ),
        ("memory beside PlayCanvas", own.memory / results["playcanvas"].memory, MEMORY_BAR),
        ("at rest", own.rest, REST_BAR),
    ]:
        print_figure(f"{what}: {ratio:.3f}, bar {bar}{'' if ratio <= bar else ' MISSED'}")
    assert own.still > 60
    assert own.turned > 60
