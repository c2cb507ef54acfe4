"""Frames of generators in other engines: as good as the engine's own picture of the baked file.

Each engine's example page draws models of several families by WebGL 2 and WebAssembly. Pictures are
written to the folder of the engine in pytest's temporary files.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass, field
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
from support.web.engines import ENGINES, engine_pages
from support.web.pages import unpacked
from support.web.without_webgpu import page_without_webgpu, python_picture
from web.families import export_family

pytestmark = pytest.mark.slow

_FAMILIES = ("gauhuman", "gart", "sequence")  # plain colours, those of a camera, and a clip
_SHARES = (0.0, 0.35, 0.7)

# What each engine's page needs to take a picture: `picture` of the next frame, or of the settled one.
_COMMON = """
const rest = (toDraw) => new Promise((resolve) => (window.drawn = () => toDraw() && (window.drawn = () => {}, resolve(picture()))));
window.drawn = () => {};
const settled = (count = 0) => rest(() => ++count > 2 && isSettled());
window.frame = async (share, { settled: isLast = true } = {}) => {
  await walkTo(share);
  return isLast ? settled() : rest(() => true);
};
"""
_PICTURES = {
    "playcanvas": """
let isSettled = () => isReady, isReady = false;
app.systems.gsplat.on("frame:ready", (_camera, _layer, ready, loading) => (isReady = ready && !loading));
app.on("frameend", () => window.drawn());
const picture = () => {
  const matrices = [camera.camera.viewMatrix, person.entity.getWorldTransform(), camera.camera.projectionMatrix];
  return [app.graphicsDevice.canvas.toDataURL(), matrices.map((matrix) => [...matrix.data])];
};
box.enabled = false;
window.baked = async (ply) => {
  const asset = new pc.Asset(ply, "gsplat", { url: ply });
  app.assets.add(asset);
  app.assets.load(asset);
  await new Promise((resolve, reject) => asset.once("load", resolve).once("error", reject));
  const entity = new pc.Entity();
  entity.addComponent("gsplat", { asset });
  person.entity.enabled = false;
  up.addChild(entity);
  const result = await settled();
  entity.destroy();
  person.entity.enabled = true;
  return result;
};
""",
    "babylon": """
let shown = person.mesh;
const isSettled = () => shown.isReady(true) && (shown === person.mesh || shown._isDepthSortSettled);
scene.onAfterRenderObservable.add(() => window.drawn());
const picture = () => {
  const view = camera.getViewMatrix().multiply(BABYLON.Matrix.Scaling(1, 1, -1)); // looks along -z
  const matrices = [view, person.mesh.getWorldMatrix(), camera.getProjectionMatrix()];
  return [engine.getRenderingCanvas().toDataURL(), matrices.map((matrix) => [...matrix.m])];
};
box.setEnabled(false);
window.baked = async (ply) => {
  const file = await (await fetch(ply)).arrayBuffer();
  const { buffer, sh, shDegree } = await BABYLON.GaussianSplattingMesh.ConvertPLYWithSHToSplatAsync(file);
  shown = new BABYLON.GaussianSplattingMesh("baked", null, scene);
  [shown.parent, shown.scaling.z] = [up, -1];
  person.mesh.setEnabled(false);
  await shown.updateDataAsync(buffer, sh ?? undefined, undefined, shDegree);
  const result = await settled();
  shown.dispose();
  shown = person.mesh;
  shown.setEnabled(true);
  return result;
};
""",
    "spark": """
const isSettled = () => spark.activeSplats > 0 && !spark.sorting && !spark.sortDirty;
renderer.setAnimationLoop(() => {
  renderer.render(scene, camera);
  window.drawn();
});
const picture = () => {
  const matrices = [camera.matrixWorldInverse, person.object.matrixWorld, camera.projectionMatrix];
  return [renderer.domElement.toDataURL(), matrices.map((matrix) => matrix.elements)];
};
box.visible = false;
window.baked = async (ply) => {
  const splats = new SPARK.SplatMesh({ url: ply });
  await splats.initialized;
  person.object.visible = false;
  up.add(splats);
  const result = await settled();
  up.remove(splats);
  splats.dispose();
  person.object.visible = true;
  await settled(); // the engine shows what was there until other objects are sorted
  return result;
};
""",
}


@dataclass(frozen=True)
class Shown:
    """An engine's page with a model."""

    page: Any
    address: str
    pictures: Path
    known: dict[tuple[Path, float], tuple[np.ndarray, Camera]] = field(default_factory=dict)

    def open(self, family: str, engine: str) -> None:
        self.page.goto(f"{self.address}/{engine}.html?provider=wasm&src=/{family}.onnx")
        self.page.wait_for_function("window.walkTo")
        self.page.evaluate(f"() => {{ {_COMMON} {_PICTURES[engine]} }}")

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

    def expected(self, model: Path, share: float, camera: Camera) -> np.ndarray:
        """Return Python's picture; all pages have the same camera."""
        key = (model, share)
        if key not in self.known:
            self.known[key] = (expected_picture(model, share, camera), camera)
        image, same = self.known[key]
        np.testing.assert_allclose(camera.view, same.view, atol=1e-4 * abs(camera.view).max())
        assert camera.fx == pytest.approx(same.fx, rel=1e-5)
        return image


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
    contents = engine_pages(folder)
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
@pytest.mark.parametrize("engine", ENGINES)
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
        expected = shown.expected(models[family], share, camera)
        assert (expected > 0.2).mean() > 0.005
        assert psnr(image, expected) >= psnr(baked, expected) - 1
        if pictures:
            assert psnr(first, image) > psnr(first, pictures[-1]) + 3
        pictures.append(image)
    assert all(psnr(a, b) < 34 for a, b in pairwise(pictures))
