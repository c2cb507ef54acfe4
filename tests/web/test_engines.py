"""Frames of generators in other engines: as good as the engine's own picture of the baked file.

Each engine's example page draws models of several families by WebGL 2 and WebAssembly. Pictures are
written to the folder of the engine in pytest's temporary files.
"""

import io
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.runtime.baking import bake
from gsgen.runtime.checks.level import scene_of
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import psnr
from gsgen.sdk.binding import FrameSession
from support.commands import ROOT
from support.web.packages import package, require_node
from support.web.pages import unpacked
from support.web.without_webgpu import page_without_webgpu, python_picture
from web.families import export_family

pytestmark = pytest.mark.slow

_EXAMPLES = ROOT / "docs/examples/engines"
_FAMILIES = ("gauhuman", "gart", "sequence")  # plain colours, those of a camera, and a clip
_SHARES = (0.0, 0.35, 0.7)

# What each engine's page needs to take a picture: the settled one, or that of the next frame.
_PICTURES = {
    "playcanvas": """
const shown = new Map();
const picture = ({ settled }) => new Promise((resolve) => {
  let [isReady, count] = [false, 0];
  const ready = app.systems.gsplat.on("frame:ready", (_camera, _layer, ready, loading) => (isReady = ready && !loading));
  const end = app.on("frameend", () => {
    count += 1;
    if (settled && !(isReady && count > 2)) return;
    ready.off();
    end.off();
    const data = (matrix) => [...matrix.data];
    const matrices = [camera.camera.viewMatrix, person.entity.getWorldTransform(), camera.camera.projectionMatrix];
    resolve([app.graphicsDevice.canvas.toDataURL(), matrices.map(data)]);
  });
});
window.hideRest = () => (box.enabled = false);
window.frame = async (share, { settled = true } = {}) => {
  const next = walkTo(share);
  await next;
  return picture({ settled });
};
window.baked = async (ply) => {
  const asset = new pc.Asset(ply, "gsplat", { url: ply });
  app.assets.add(asset);
  app.assets.load(asset);
  await new Promise((resolve, reject) => asset.once("load", resolve).once("error", reject));
  const entity = new pc.Entity();
  entity.addComponent("gsplat", { asset });
  person.entity.enabled = false;
  up.addChild(entity);
  const result = await picture({ settled: true });
  entity.destroy();
  person.entity.enabled = true;
  return result;
};
"""
}


@dataclass(frozen=True)
class Shown:
    """An engine's page with a model."""

    page: Any
    address: str
    pictures: Path

    def open(self, family: str, engine: str) -> None:
        self.page.goto(f"{self.address}/{engine}.html?provider=wasm&src=/{family}.onnx")
        self.page.wait_for_function("window.walkTo")
        self.page.evaluate(f"() => {{ {_PICTURES[engine]} hideRest(); }}")

    def picture(self, script: str, name: str) -> tuple[np.ndarray, Camera]:
        """Return a picture, and its camera in the model's axes."""
        url, (view, world, projection) = self.page.evaluate(f"async () => {script}")
        data = unpacked(url[url.index(",") + 1 :], np.uint8).tobytes()
        (self.pictures / f"{name}.png").write_bytes(data)
        image = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), np.float64) / 255
        height, width = image.shape[:2]
        view, world, projection = (np.reshape(each, (4, 4)).T for each in (view, world, projection))
        lens = {"fx": projection[0, 0] * width / 2, "fy": projection[1, 1] * height / 2}
        place = {"cx": width / 2, "cy": height / 2, "width": width, "height": height, "near": 0.001}
        return image, Camera(view=np.diag([1, -1, -1, 1]) @ view @ world, **lens, **place)


@pytest.fixture(scope="module")
def models(walking_person: bytes, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("models")
    (folder / "gauhuman.onnx").write_bytes(walking_person)
    return {
        name: folder / f"{name}.onnx" if name == "gauhuman" else export_family(name, folder)
        for name in _FAMILIES
    }


@pytest.fixture(scope="module")
def shown(
    models: dict[str, Path], ort_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Shown]:
    folder = tmp_path_factory.mktemp("engines")
    engine = package("playcanvas-2.23.3", needs_node=True) / "src/index.js"
    esbuild = package("frameworks") / "node_modules/esbuild/bin/esbuild"
    built = folder / "playcanvas.mjs"
    command = [require_node(), str(esbuild), str(engine), "--bundle", "--format=esm"]
    subprocess.run([*command, f"--outfile={built}"], check=True, capture_output=True)
    contents = {"/none.html": b"<!doctype html>"}
    contents["/playcanvas/build/playcanvas.mjs"] = built.read_bytes()
    contents["/playcanvas.html"] = (_EXAMPLES / "playcanvas.html").read_bytes()
    for name, path in models.items():
        contents[f"/{name}.onnx"] = path.read_bytes()
        for share in _SHARES:
            target = folder / "frame.ply"
            bake(path, target, time=time_of(path, share))
            contents[f"/{name}-{share}.ply"] = target.read_bytes()
    with page_without_webgpu(contents, ort_folder) as (page, address):
        yield Shown(page, address, folder)


def time_of(path: Path, share: float) -> float:
    """Return a share of the range of a model's time."""
    with FrameSession(path, provider="cpu") as session:
        assert isinstance(session.manifest, GeneratorManifest)
        [(low, high)] = [
            entry.range or (0, 1) for entry in session.manifest.inputs if entry.role == "time"
        ]
    return low + share * (high - low)


def expected_picture(path: Path, share: float, camera: Camera) -> np.ndarray:
    with FrameSession(path, provider="cpu") as session:
        manifest = session.manifest
        assert isinstance(manifest, GeneratorManifest)
        [name] = [entry.name for entry in manifest.inputs if entry.role == "time"]
        outputs = session.run({name: time_of(path, share)}, copy=True)
        return python_picture(scene_of(manifest, {name: outputs[name] for name in outputs}), camera)


@pytest.mark.parametrize("family", _FAMILIES)
@pytest.mark.parametrize("engine", _PICTURES)
def test_frames_are_as_good_as_the_baked_file_and_never_stale(
    engine: str, family: str, shown: Shown, models: dict[str, Path]
) -> None:
    shown.open(family, engine)
    pictures: list[np.ndarray] = []
    for share in _SHARES:
        name = f"{engine}-{family}-{share}"
        # The first picture after the time has moved shows the new frame, in the order of an old one.
        first, _ = shown.picture(f"frame({share}, {{ settled: false }})", f"{name}-first")
        image, camera = shown.picture(f"frame({share})", name)
        baked, _ = shown.picture(f"baked('/{family}-{share}.ply')", f"{name}-baked")
        expected = expected_picture(models[family], share, camera)
        assert (expected > 0.2).mean() > 0.005
        assert psnr(image, expected) >= psnr(baked, expected) - 1
        if pictures:
            assert psnr(first, image) > psnr(first, pictures[-1]) + 3
        pictures.append(image)
    assert all(psnr(a, b) < 34 for a, b in pairwise(pictures))
