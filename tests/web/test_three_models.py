"""Models in scenes of three.js, which draws them by itself: the guide's page, a pass, a headset.

The page draws by WebGL 2 and WebAssembly. Its pictures are written to pytest's temporary files.
"""

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.srgb import linear_of_srgb, srgb_of_linear
from gsgen.formats.shared.harmonics import sh_basis
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.sdk.binding import FrameSession
from support.commands import ROOT
from support.web.packages import package
from support.web.pages import unpacked
from support.web.without_webgpu import page_without_webgpu, python_picture

pytestmark = pytest.mark.slow

_PAGE = ROOT / "docs/examples/three/walk.html"
_DECIBELS = 30  # three.js cuts Gaussians off at two deviations, and stores colours in bytes

_DRAWN = """
window.drawn = (draw = () => renderer.render(scene, camera)) => {
  renderer.setAnimationLoop(null);
  draw();
  const url = renderer.domElement.toDataURL();
  return url.slice(url.indexOf(",") + 1);
};
window.enter = async () => {
  let drawn = () => {};
  renderer.setAnimationLoop(() => {
    hands.update();
    renderer.render(scene, camera);
    if (renderer.xr.isPresenting) drawn();
  });
  window.pictures = async (number, take = () => null) => {
    for (; number > 1; number--) await new Promise((resolve) => (drawn = resolve));
    return new Promise((resolve) => (drawn = () => resolve(take())));
  };
  const session = await navigator.xr.requestSession("immersive-vr", { optionalFeatures: ["local-floor"] });
  await renderer.xr.setSession(session);
  await pictures(3);
};
window.matrices = () => {
  const { matrixWorld } = person.object.children[0];
  return [camera.matrixWorldInverse, matrixWorld, camera.projectionMatrix].map(({ elements }) => elements);
};
"""
# The emulator draws to the canvas; headsets have a framebuffer of their own, without which three.js fails.
_HEADSET = """
const device = new IWER.XRDevice(IWER.metaQuest3, { stereoEnabled: true });
device.installRuntime({ forceInstall: true });
device.position.set(0.2, 1.4, 2.5);
window.device = device;
window.layerOf = (gl) => {
  if (window.layer) return window.layer;
  const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
  const before = gl.getParameter(gl.FRAMEBUFFER_BINDING);
  window.layer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, window.layer);
  for (const [format, attachment] of [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]]) {
    const buffer = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
    gl.renderbufferStorage(gl.RENDERBUFFER, format, width, height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer);
  }
  gl.bindFramebuffer(gl.FRAMEBUFFER, before);
  return window.layer;
};
Object.defineProperty(XRWebGLLayer.prototype, "framebuffer", { get() { return layerOf(this.context); } });
"""


@pytest.fixture(scope="module")
def opened(
    ort_folder: Path, walking_person: bytes, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Any, str, Path]]:
    """Yield a browser's page, its server's address, and the folder of pictures."""
    folder = tmp_path_factory.mktemp("three")
    (folder / "walk.onnx").write_bytes(walking_person)
    html = _PAGE.read_bytes()
    emulator = (package("iwer-2.5.0") / "iwer.min.js").read_bytes()
    headset = b"<script src=/iwer.js></script><script>" + _HEADSET.encode() + b"</script>"
    contents = {
        "/none.html": b"",
        "/walk.html": html,
        "/headset.html": html.replace(b"<canvas", headset + b"<canvas", 1),
        "/iwer.js": emulator,
        "/walk.onnx": walking_person,
    }
    with page_without_webgpu(contents, ort_folder) as (page, address):
        yield page, address, folder


def open_page(opened: tuple[Any, str, Path], name: str) -> Any:
    page, address, _ = opened
    page.goto(f"{address}/{name}.html?webgl&provider=wasm")
    page.wait_for_function("window.hands")
    page.evaluate(f"() => {{ {_DRAWN} }}")
    return page


@pytest.fixture
def shown(opened: tuple[Any, str, Path]) -> Any:
    """The guide's page of three.js, at rest; each test leaves it as it was."""
    page = opened[0]
    if not page.url.endswith("/walk.html?webgl&provider=wasm"):
        open_page(opened, "walk")
    return page


def picture(opened: tuple[Any, str, Path], name: str, script: str) -> np.ndarray:
    """Return the picture that a script draws, and write it to the folder."""
    text = opened[0].evaluate(f"async () => {{ {script} }}")
    data = unpacked(text, np.uint8).tobytes()
    (opened[2] / f"{name}.png").write_bytes(data)
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), np.float64) / 255


def expected_picture(page: Any, path: Path, share: float, size: tuple[int, int]) -> np.ndarray:
    """Return Python's picture of the page's camera, whose colours are blended as light."""
    view, world, projection = (np.reshape(each, (4, 4)).T for each in page.evaluate("matrices()"))
    width, height = size
    place = np.diag([1, -1, -1, 1]) @ view @ world
    place[:3] /= np.cbrt(np.linalg.det(place[:3, :3]))  # the object is scaled
    camera = Camera(
        view=place,
        fx=projection[0, 0] * width / 2,
        fy=projection[1, 1] * height / 2,
        cx=width / 2,
        cy=height / 2,
        width=width,
        height=height,
        near=0.001,
    )
    low, high = page.evaluate("[person.frames.time.low, person.frames.time.high]")
    with FrameSession(path, provider="cpu") as session:
        assert isinstance(session.manifest, GeneratorManifest)
        outputs = session.run({"time": low + share * (high - low)}, copy=True)
        specs = session.manifest.outputs
        assert specs.gaussians is not None
        assert specs.appearance is not None
        rows, colors = outputs[specs.gaussians.name], outputs[specs.appearance.name]
    eye = -np.linalg.solve(place[:3, :3], place[:3, 3])
    directions = (rows[:, :3] - eye) / np.linalg.norm(rows[:, :3] - eye, axis=1, keepdims=True)
    degree = int(np.sqrt(colors.shape[1] / 3)) - 1
    basis = sh_basis(directions, degree)
    colors = 0.5 + np.einsum("nk,nkc->nc", basis, colors.reshape(len(rows), -1, 3))
    light = linear_of_srgb(np.clip(colors, 0, 1)).astype(np.float32)
    splats = SplatData(rows, light, "rgb", color_space="linear")
    return python_picture(Scene([splats]), camera)


def test_the_pictures_are_those_of_python_also_when_visitors_turn(
    shown: Any, opened: tuple[Any, str, Path]
) -> None:
    alone = "scene.background = new THREE.Color(0); box.visible = false;"
    before = picture(opened, "start", f"{alone} return drawn();")
    size = (before.shape[1], before.shape[0])
    path = opened[2] / "walk.onnx"
    expected = expected_picture(shown, path, 0, size)
    assert (expected > 0.2).mean() > 0.02
    assert psnr(before, expected) >= _DECIBELS
    # 1. A later moment: the first picture shows it.
    later = picture(
        opened, "later", "await clock.seek(0.4 * person.frames.time.seconds); return drawn();"
    )
    assert psnr(later, expected_picture(shown, path, 0.4, size)) >= _DECIBELS
    assert psnr(later, before) < 30
    # 2. The visitor turns the camera by OrbitControls; nothing is run again.
    shown.evaluate("""() => {
      window.runs = 0;
      const { run } = person.frames;
      person.frames.run = (...values) => (runs++, run(...values));
    }""")
    shown.mouse.move(160, 120)
    shown.mouse.down()
    shown.mouse.move(60, 100, steps=3)
    shown.mouse.up()
    turned = picture(opened, "turned", "return drawn();")
    assert shown.evaluate("runs") == 0
    assert psnr(turned, later) < 30
    assert psnr(turned, expected_picture(shown, path, 0.4, size)) >= _DECIBELS
    # 3. It is scaled.
    small = picture(opened, "small", "person.object.scale.multiplyScalar(0.5); return drawn();")
    assert psnr(small, expected_picture(shown, path, 0.4, size)) >= _DECIBELS
    shown.evaluate("""() => {
      person.object.scale.multiplyScalar(2);
      controls.reset();
      controls.target.set(0, 1, 0);
      controls.update();
      scene.background = new THREE.Color(0x30363d);
      box.visible = true;
      return clock.seek(0);
    }""")


@pytest.mark.usefixtures("shown")
def test_surfaces_hide_gaussians_and_are_hidden(opened: tuple[Any, str, Path]) -> None:
    place = "box.position.set(0, 0.9, {depth}); person.object.visible = {visible}; return drawn();"
    images = {
        (depth, visible): picture(
            opened, f"box{depth}-{visible}", place.format(depth=depth, visible=visible)
        )
        for depth in (0.7, -0.7)
        for visible in ("true", "false")
    }
    # 1. In front of the person, the box is as it is without one.
    only_box = images[0.7, "false"]
    is_box = only_box[..., 0] > 2 * only_box[..., 2]
    assert is_box.sum() > 1000
    np.testing.assert_array_equal(images[0.7, "true"][is_box], only_box[is_box])
    assert np.abs(images[0.7, "true"] - only_box).max() > 0.3  # the person is beside it
    # 2. Behind the person, it is hidden by what is opaque.
    only_box = images[-0.7, "false"]
    is_box = only_box[..., 0] > 2 * only_box[..., 2]
    change = np.abs(images[-0.7, "true"] - only_box).max(axis=2)[is_box]
    assert (change > 0.2).mean() > 0.2
    opened[0].evaluate("box.position.set(0.5, 0.4, 0.2); person.object.visible = true; null")


@pytest.mark.usefixtures("shown")
def test_passes_of_three_change_the_picture(opened: tuple[Any, str, Path]) -> None:
    plain = picture(opened, "plain", "return drawn();")
    gray = picture(
        opened,
        "gray",
        """
        const { luminance, pass, vec3, vec4 } = await import("three/tsl");
        const light = vec4(vec3(luminance(pass(scene, camera).rgb)), 1);
        const pipeline = new THREE.RenderPipeline(renderer, light);
        const text = drawn(() => pipeline.render());
        pipeline.dispose();
        return text;
        """,
    )
    assert (plain[..., 2] > plain[..., 0] + 0.3).sum() > 50  # the person's shirt
    np.testing.assert_array_equal(gray[..., 0], gray[..., 1])
    np.testing.assert_array_equal(gray[..., 0], gray[..., 2])
    light = linear_of_srgb(plain) @ [0.2126, 0.7152, 0.0722]
    assert psnr(gray[..., 0], srgb_of_linear(light)) >= 40


def test_opacity_and_modes_are_those_of_the_object(
    shown: Any, opened: tuple[Any, str, Path]
) -> None:
    none = picture(opened, "none", "person.object.visible = false; return drawn();")
    plain = picture(opened, "plain", "person.object.visible = true; return drawn();")
    clear = picture(opened, "clear", "person.opacity = 0; return drawn();")
    np.testing.assert_array_equal(clear, none)
    faint = picture(opened, "faint", "person.opacity = 0.5; return drawn();")
    alpha = picture(opened, "alpha", "person.opacity = 1; person.mode = 'alpha'; return drawn();")
    depth = picture(opened, "depth", "person.mode = 'depth'; return drawn();")
    solid = (alpha > 0.995).all(axis=2)
    assert solid.sum() > 100
    assert (alpha >= none - 1 / 255).all()
    gray = depth[solid]
    assert np.ptp(gray, axis=1).max() < 1.5 / 255
    assert 0.2 < gray.min() < gray.max() < 1
    assert np.abs(faint - none).sum() < 0.8 * np.abs(plain - none).sum()
    with pytest.raises(Exception, match="mode: is red, expected color, depth, alpha"):
        shown.evaluate("person.mode = 'red'")
    shown.evaluate("person.mode = 'color'")


def test_models_stand_upright_whatever_their_upward_axis(shown: Any) -> None:
    upward = shown.evaluate(
        """async () => {
          const { ThreeModel, loadThree } = await import("gsgen/engines/three.js");
          const modules = await loadThree();
          return [0, 1, 2].flatMap((axis) => [-1, 1].map((sign) => {
            const up = [0, 0, 0].with(axis, sign);
            const model = new ThreeModel(modules, { ...person.frames, up, destroy() {} });
            const turned = new THREE.Vector3(...up).applyMatrix4(model.object.children[0].matrix);
            model.destroy();
            return turned.toArray();
          }));
        }"""
    )
    np.testing.assert_allclose(upward, [[0, 1, 0]] * 6, atol=1e-6)


def test_models_of_a_clock_show_the_same_moment_and_pictures_never_wait(shown: Any) -> None:
    answer = shown.evaluate("""async () => {
      const { ThreeClock, ThreeModel } = await import("gsgen/engines/three.js");
      const models = await Promise.all([1, 2].map(() => ThreeModel.open("/walk.onnx", { provider: "wasm" })));
      const runs = models.map(() => []);
      models.forEach(({ frames }, index) => {
        const { run } = frames;
        frames.run = (values, camera) => (runs[index].push(values.time), run(values, camera));
      });
      const both = new ThreeClock(...models);
      const rounds = [1000, 1100, 1200, 1300].map((now) => both.update(now)); // at once: one round
      await Promise.all(rounds);
      await both.update(1400); // a later moment
      await both.update(1400); // the same one
      both.paused = true;
      await both.update(9000);
      await both.seek(0.1);
      const time = both.time;
      models.forEach((model) => model.destroy());
      await both.seek(0.2); // without them
      return { runs, time, seconds: models[0].frames.time.seconds };
    }""")
    first, second = answer["runs"]
    assert first == second
    assert len(first) == 3
    assert first[0] == 0
    np.testing.assert_allclose(np.diff(first), [0.4 / answer["seconds"], -0.3 / answer["seconds"]])
    assert answer["time"] == 0.1


# Enters the headset, counts the work for a later moment there, and leaves it.
_EYES = """async () => {
  const uploads = [];
  for (const name of ["texImage2D", "texSubImage2D", "bufferData", "bufferSubData"]) {
    const own = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...values) {
      const data = values.find((value) => ArrayBuffer.isView(value));
      if (data?.byteLength > 4000) uploads.push(data.byteLength);
      return own.apply(this, values);
    };
  }
  const splats = person.object.children[0];
  const counts = { runs: 0, sorts: 0, fills: 0 };
  const count = (object, name, key) => {
    const own = object[name];
    object[name] = (...values) => (counts[key]++, own.apply(object, values));
  };
  count(person.frames, "run", "runs");
  count(splats._sort, "computeCPU", "sorts");
  count(person._gaussians, "fill", "fills");
  const begin = () => {
    Object.assign(counts, { runs: 0, sorts: 0, fills: 0 });
    uploads.length = 0;
  };
  const cost = () => JSON.parse(JSON.stringify([counts, uploads]));
  await enter();
  // 1. A later moment: one picture, of two eyes.
  begin();
  await clock.seek(0.3 * person.frames.time.seconds);
  const both = await pictures(1, () => {
    const gl = renderer.getContext();
    const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
    const before = gl.getParameter(gl.READ_FRAMEBUFFER_BINDING);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, layerOf(gl));
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, before);
    const eyes = renderer.xr.getCamera().cameras.map(({ matrixWorld, projectionMatrix }) => (
      [[...matrixWorld.elements], [...projectionMatrix.elements]]));
    const text = btoa(Array.from(pixels, (byte) => String.fromCharCode(byte)).join(""));
    return { text, size: [height, width, 4], cost: cost(), eyes };
  });
  await renderer.xr.getSession().end();
  return both;
}"""

# Draws an eye of the headset alone.
_EYE = """async ([world, projection, width, height]) => {
  renderer.setAnimationLoop(null);
  renderer.setSize(width, height, false);
  const eye = new THREE.PerspectiveCamera();
  eye.matrixAutoUpdate = eye.matrixWorldAutoUpdate = false;
  eye.near = camera.near;
  eye.far = camera.far;
  eye.matrixWorld.fromArray(world);
  eye.matrixWorldInverse.copy(eye.matrixWorld).invert();
  eye.projectionMatrix.fromArray(projection);
  eye.projectionMatrixInverse.copy(eye.projectionMatrix).invert();
  person.object.children[0]._sortInitialized = false;
  renderer.render(scene, eye);
  const url = renderer.domElement.toDataURL();
  return url.slice(url.indexOf(",") + 1);
}"""

# Moves the two controllers, one after the other.
_HANDS = """async () => {
  await enter();
  const { left, right } = device.controllers;
  const { center } = person.sphere;
  const places = () => ({
    position: person.object.position.toArray(), scale: person.object.scale.toArray(),
    turn: person.object.quaternion.toArray(), rig: rig.position.toArray(),
  });
  const results = [places()];
  const to = async (hand, x, y, z) => { hand.position.set(x, y, z); await pictures(3); };
  const press = async (hand, button, value) => { hand.updateButtonValue(button, value); await pictures(3); };
  // 1. One hand moves it.
  await to(right, center.x, center.y, center.z);
  await press(right, "squeeze", 1);
  await to(right, center.x + 0.3, center.y, center.z - 0.1);
  results.push(places());
  await press(right, "squeeze", 0);
  await to(right, center.x + 0.5, center.y, center.z);
  results.push(places());
  // 2. Two hands, twice as far apart.
  await to(right, center.x + 0.4, center.y, center.z);
  await to(left, center.x + 0.2, center.y, center.z);
  await press(right, "squeeze", 1);
  await press(left, "squeeze", 1);
  right.position.set(center.x + 0.5, center.y, center.z);
  await to(left, center.x + 0.1, center.y, center.z);
  results.push(places());
  await press(left, "squeeze", 0);
  await press(right, "squeeze", 0);
  // 3. A teleport to the ground, where the right one points.
  right.quaternion.set(-Math.sin(Math.PI / 8), 0, 0, Math.cos(Math.PI / 8));
  await to(right, 0, 1.4, 2);
  await press(right, "trigger", 1);
  await press(right, "trigger", 0);
  results.push(places());
  // 4. The headset is put away while a hand holds the person.
  await to(right, ...person.sphere.center.toArray());
  await press(right, "squeeze", 1);
  const held = hands._held.size;
  await renderer.xr.getSession().end();
  return [...results, [held, hands._held.size]];
}"""


@pytest.fixture(scope="module")
def headset(opened: tuple[Any, str, Path]) -> Any:
    """The guide's page where a headset is."""
    return open_page(opened, "headset")


def test_each_eye_is_the_picture_of_its_camera_by_one_sort_upload_and_run(
    headset: Any, opened: tuple[Any, str, Path]
) -> None:
    """The person's colours are of harmonics: each eye has its own."""
    both = headset.evaluate(_EYES)
    counts, uploads = both["cost"]
    assert counts == {"runs": 1, "sorts": 1, "fills": 1}
    # Colours and the order, 4 bytes of a row, and the centre and the covariance in three times 16.
    texture = min(uploads)
    assert sorted(uploads) == [texture, texture, 4 * texture, 4 * texture, 4 * texture]
    pixels = unpacked(both["text"], np.uint8).reshape(both["size"])[::-1]
    Image.fromarray(pixels[..., :3]).save(opened[2] / "eyes.png")
    height, width = pixels.shape[:2]
    half = width // 2
    eyes = [pixels[:, :half, :3] / 255, pixels[:, half:, :3] / 255]
    assert psnr(*eyes) < 30
    for number, (world, projection) in enumerate(both["eyes"]):
        words = json.dumps([world, projection, half, height])
        single = picture(opened, f"eye{number}", f"return ({_EYE})({words});")
        assert psnr(eyes[number], single) >= 60


def test_controllers_grab_scale_and_teleport(headset: Any) -> None:
    start, moved, released, scaled, away, held = headset.evaluate(_HANDS)
    shift = np.subtract(moved["position"], start["position"])
    np.testing.assert_allclose(shift, [0.3, 0, -0.1], atol=1e-6)
    np.testing.assert_allclose(moved["scale"], start["scale"], rtol=1e-5)
    assert released == moved
    np.testing.assert_allclose(scaled["scale"], 2 * np.array(moved["scale"]), rtol=1e-5)
    np.testing.assert_allclose(scaled["turn"], start["turn"], atol=1e-6)
    assert away["position"] == scaled["position"]
    np.testing.assert_allclose(away["rig"], [-0.2, 0, 0.6 - 2.5], atol=1e-5)
    assert held == [1, 0]
