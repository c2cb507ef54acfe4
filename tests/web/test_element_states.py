"""The states of `<gsgen-model>`: how it loads, fails and recovers, and what it keeps meanwhile."""

import gzip
import re
import zlib
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

from gsgen.formats import write_spz
from gsgen.reference_plugins.writing.knot import torus_knot
from support.commands import ROOT
from support.web.pages import WebSite

pytestmark = pytest.mark.slow

_SCRIPT = """
window.made = (attributes = {}, ...children) => {
  const element = document.createElement("gsgen-model");
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  element.events = [];
  for (const name of ["load", "error", "recover", "statechange", "play", "pause", "ended"]) {
    const words = ({ detail }) => [name, detail?.state ?? detail?.message].filter(Boolean).join(" ");
    element.addEventListener(name, (event) => element.events.push(words(event)));
  }
  document.body.append(element);
  return element;
};
window.pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));
window.until = async (condition) => { while (!condition()) await pause(10); };
window.source = (src, type) => Object.assign(document.createElement("source"), { src, type });
"""


@pytest.fixture(scope="module")
def knot(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("knot") / "knot.spz"
    write_spz(path, torus_knot(300, degree=0))
    return path.read_bytes()


@pytest.fixture
def page(site: WebSite, knot: bytes) -> Iterator[Any]:
    """A page with the element's class, and two models; it counts what is requested."""
    site.contents["/knot.spz"] = site.contents["/other.spz"] = knot
    site.contents["/broken.spz"] = b"\x1f\x8bno gzip"
    site.contents["/states.html"] = f"""<!doctype html><meta charset=utf-8>
      <style>gsgen-model {{ width: 64px; height: 48px; aspect-ratio: auto }}</style>
      <script type=module src=/client/gsgen.js></script><script>{_SCRIPT}</script>""".encode()
    site.open("/states.html")
    site.page.wait_for_function("Boolean(customElements.get('gsgen-model'))")
    site.requests.clear()
    yield site.page
    site.headers.clear()


_LOADS = {
    # What is done with an element, and its state, whether it is complete, and its events.
    "no src": ("made()", ["empty", True, []]),
    "src": ("made({ src: 'knot.spz' })", ["ready", True, ["statechange loading", "statechange ready", "load"]]),
    "src as a property": (
        "Object.assign(made(), { src: 'knot.spz' })",
        ["ready", True, ["statechange loading", "statechange ready", "load"]],
    ),
    "eager, out of view": (
        "made({ src: 'knot.spz', loading: 'eager', style: 'position: absolute; top: 9000px' })",
        ["ready", True, ["statechange loading", "statechange ready", "load"]],
    ),
    "lazy, out of view": (
        "made({ src: 'knot.spz', style: 'position: absolute; top: 9000px' })",
        ["empty", False, []],
    ),
    "not displayed, eager": (
        "made({ src: 'knot.spz', loading: 'eager', hidden: '' })",
        ["ready", True, ["statechange loading", "statechange ready", "load"]],
    ),
    "missing file": (
        "made({ src: 'no.spz' })",
        ["failed", True, ["statechange loading", "statechange failed", "error HOST/no.spz: cannot be loaded: 404 File not found"]],
    ),
    "no address": (
        "made({ src: 'http://[' })",
        ["failed", True, ["statechange loading", "statechange failed", "error http://[: is no address"]],
    ),
    "src corrected": (
        "(async () => { const e = made({ src: 'no.spz' }); await e.ready.catch(() => {}); e.events.length = 0; e.src = 'knot.spz'; return e; })()",
        ["ready", True, ["statechange loading", "statechange ready", "load"]],
    ),
    "src replaced while it loads": (
        "(() => { const e = made({ src: 'no.spz', loading: 'eager' }); e.src = 'knot.spz'; return e; })()",
        ["ready", True, ["statechange loading", "statechange ready", "load"]],
    ),
    "src removed": (
        "(async () => { const e = made({ src: 'knot.spz' }); await e.ready; e.events.length = 0; e.removeAttribute('src'); return e; })()",
        ["empty", True, ["statechange empty"]],
    ),
    "moved": (
        "(async () => { const e = made({ src: 'knot.spz' }); await e.ready; e.events.length = 0; document.body.prepend(e); return e; })()",
        ["ready", True, []],
    ),
    "removed": (
        "(async () => { const e = made({ src: 'knot.spz' }); await e.ready; e.events.length = 0; e.remove(); return e; })()",
        ["empty", False, ["statechange empty"]],
    ),
    "first source that is known": (
        "made({}, source('no.glb', 'model/gltf-binary'), source('knot.spz', 'model/spz'))",
        ["ready", True, ["statechange loading", "statechange ready", "load"]],
    ),
    "first source that loads": (
        "made({}, source('broken.spz', 'model/spz'), source('no.spz', ''), source('knot.spz', ''))",
        ["ready", True, ["statechange loading", "statechange ready", "load"]],
    ),
    "sources that come later": (
        "(() => { const e = made({}); e.append(source('knot.spz', '')); return e; })()",
        ["ready", True, ["statechange loading", "statechange ready", "load"]],
    ),
    "no source that is known": (
        "made({}, source('no.glb', 'model/gltf-binary'))",
        ["empty", True, []],
    ),
}  # fmt: skip


def test_an_element_loads_what_it_names(page: Any) -> None:
    """In every way that pages name a model, and take it back."""
    results = page.evaluate(
        """async (cases) => {
          const results = {};
          for (const [name, [code]] of Object.entries(cases)) {
            const element = await eval(code);
            const left = pause(name.includes("out of view") || !element.src && !element.children.length ? 300 : 9000);
            await Promise.race([element.ready.catch(() => {}), left]);
            await pause(0);
            const events = element.events.map((words) => words.replace(location.origin, "HOST"));
            results[name] = [element.state, element.complete, events];
            element.remove();
          }
          return results;
        }""",
        _LOADS,
    )
    assert results == {name: expected for name, (_, expected) in _LOADS.items()}


def test_an_address_is_downloaded_once(page: Any, site: WebSite) -> None:
    """For five elements, for one that moves, one that comes back, and one whose device is lost."""
    page.evaluate(
        """async () => {
          const elements = [1, 2, 3, 4, 5].map(() => made({ src: "knot.spz" }));
          await Promise.all(elements.map(({ ready }) => ready));
          const [first, second] = elements;
          const box = document.createElement("div");
          document.body.append(box);
          box.append(first);
          await first.ready;
          second.remove();
          await pause(50);
          document.body.append(second);
          await until(() => second.state === "ready");
          first._shown.renderer.device.destroy();
          await until(() => elements.every(({ state }) => state === "loading"));
          await Promise.all(elements.map(({ ready }) => ready));
        }"""
    )
    assert site.requests.count("/knot.spz") == 1


def test_the_last_picture_stays_until_the_next_is_whole(
    page: Any, site: WebSite, knot: bytes
) -> None:
    """While a slow file arrives, the model before it can still be turned and picked."""
    gate: list[Any] = []
    page.route("**/slow.spz", lambda route: gate.append(route))
    page.evaluate(
        """async () => {
          window.element = made({ src: "knot.spz" });
          await element.ready;
          window.before = element._shown;
          element.src = "slow.spz";
        }"""
    )
    page.wait_for_function("element.state === 'loading'")
    assert page.evaluate("element._shown === before && Boolean(element.getBoundingBox())")
    page.evaluate("element.orbit = { azimuth: 77 }")
    page.wait_for_function("!element._frameRequest && !element._isDrawing")
    while not gate:
        page.wait_for_timeout(20)
    gate[0].fulfill(body=knot, headers={"Access-Control-Allow-Origin": "*"})
    page.evaluate("element.ready.then(() => null)")
    page.unroute("**/slow.spz")  # routes switch the browser's cache off
    assert page.evaluate("element._shown !== before && before.isDestroyed")


def test_three_losses_of_the_device_keep_camera_time_and_bytes(page: Any, site: WebSite) -> None:
    result = page.evaluate(
        """async () => {
          const element = made({ src: "knot.spz" });
          await element.ready;
          element.orbit = { azimuth: 123, elevation: -10, radius: 7, target: [1, 0, 0], fieldOfView: 33 };
          element.playbackRate = 2;
          await until(() => !element._frameRequest && !element._isDrawing);
          const orbits = [element.orbit];
          element.events.length = 0;
          for (let loss = 0; loss < 3; loss++) {
            element._shown.renderer.device.destroy();
            await until(() => element.state === "loading");
            await element.ready;
            await pause(1000);
            orbits.push(element.orbit);
          }
          return [orbits, element.events, element.state, element.playbackRate];
        }"""
    )
    orbits, events, state, rate = result
    for orbit in orbits[1:]:
        assert orbit == orbits[0]
    assert events == ["statechange loading", "statechange ready", "recover"] * 3
    assert (state, rate) == ("ready", 2)
    assert site.requests.count("/knot.spz") == 1


_LOSSES = {
    # When the device is lost; the element has a camera of its own, and its model is shown or loaded.
    "at rest": "lose(element)",
    "in mid frame": "element.requestFrame(); await frame(); lose(element)",
    "while a point is picked": "const picking = element.pick(30, 20).catch(() => null); lose(element); await picking",
    "while a picture is drawn": "const drawing = element.toBlob().catch(() => null); lose(element); await drawing",
    "while the camera moves": "element.autoRotate = true; await frame(); lose(element); element.autoRotate = false",
    "out of view": "element.style.marginTop = '9000px'; await pause(200); lose(element); await pause(200); element.style.marginTop = ''",
    "while it is moved": "document.body.prepend(element); lose(element); document.body.append(element)",
    "while it is not displayed": "element.hidden = true; await frame(); lose(element); await pause(300); element.hidden = false",
    "before another model is whole": "element.src = 'other.spz'; lose(element)",
    "twice": "lose(element); await until(() => element._shown); lose(element)",
    "and the camera is set before it is back": "lose(element); await until(() => !element._shown); element.orbit = { azimuth: 50 }",
}  # fmt: skip


def test_a_loss_at_any_moment_leaves_the_model_shown(page: Any) -> None:
    """With the camera of before where the address is the same, and no error is told."""
    results = page.evaluate(
        """async (cases) => {
          const frame = () => new Promise(requestAnimationFrame);
          const losses = [];
          const lose = ({ _shown: { renderer: { device } } }) => losses.push(device.lost) && device.destroy();
          const results = {};
          for (const [name, code] of Object.entries(cases)) {
            const element = made({ src: "knot.spz" });
            await element.ready;
            element.orbit = { azimuth: 50, elevation: 10, radius: 6 };
            element.events.length = 0;
            const act = new Function("element", "lose", "frame", `return (async () => { ${code} })()`);
            await act(element, lose, frame);
            await Promise.all(losses); // the element hears of a loss no sooner
            await pause(100);
            await until(() => element.state === "ready" && element._shown?.camera);
            const told = element.events.filter((words) => words.startsWith("error"));
            results[name] = [Math.round(element.orbit.azimuth), Math.round(element.orbit.radius), told];
            element.remove();
          }
          return results;
        }""",
        _LOSSES,
    )
    kept = {name: result for name, result in results.items() if "another" not in name}
    for name, (azimuth, radius, told) in kept.items():
        assert abs(azimuth - 50) <= 5, name
        assert (radius, told) == (6, []), name
    assert results["before another model is whole"][2] == []


_FRAME_ERRORS = {
    # What breaks a frame, and what mends the next one.
    "an input": ("shown.model.update = no; shown.isStale = true", "delete shown.model.update; shown.model.update = update"),
    "the renderer": ("shown.renderer.draw = no", "delete shown.renderer.draw"),
    "a plan": ("shown.renderer.host.configure = no; shown.renderer._key = ''", "delete shown.renderer.host.configure"),
    "a uniform": ("shown.renderer._placed = no", "delete shown.renderer._placed"),
    "the queue": ("shown.renderer.device.createCommandEncoder = no", "delete shown.renderer.device.createCommandEncoder"),
    "the camera": ("shown.orbit.camera = no", "delete shown.orbit.camera"),
    "the canvas": ("element._presenter.show = no", "delete element._presenter.show"),
    "a colour": ("element._look = no", "delete element._look"),
    "an annotation": ("element._annotations.place = no", "delete element._annotations.place"),
}  # fmt: skip


def test_an_error_of_a_frame_is_taken_back_by_the_next(page: Any) -> None:
    """It is told once however often the frame fails, and covers the model no longer than that."""
    results = page.evaluate(
        """async (cases) => {
          window.addEventListener("error", (event) => event.preventDefault()); // of reportError
          const element = made({ src: "knot.spz" });
          await element.ready;
          const shown = element._shown;
          const { update } = shown.model;
          const no = () => { throw new Error("no"); };
          const alert = element.shadowRoot.querySelector("[role=alert]");
          const results = {};
          for (const [name, [breaking, mending]] of Object.entries(cases)) {
            element.events.length = 0;
            eval(breaking);
            for (let attempt = 0; attempt < 3; attempt++) {
              element.requestFrame();
              await until(() => element.state === "failed" && !element._isDrawing);
            }
            const covered = !alert.hidden && alert.textContent.includes("no");
            const refused = await element.ready.catch(({ message }) => message);
            eval(mending);
            element.requestFrame();
            await until(() => element.state === "ready");
            await element.ready;
            results[name] = [covered, alert.hidden, refused, element.events];
          }
          return results;
        }""",
        _FRAME_ERRORS,
    )
    events = ["statechange failed", "error no", "statechange ready", "recover"]
    assert results == {name: [True, True, "no", events] for name in _FRAME_ERRORS}


_ANSWERS = {
    # Headers of an answer with four million bytes, and whether it is packed.
    "plain": ({}, lambda body: body),
    "gzip": ({"Content-Encoding": "gzip"}, gzip.compress),
    "deflate": ({"Content-Encoding": "deflate"}, zlib.compress),
    "gzip in capitals": ({"Content-Encoding": "GZIP"}, gzip.compress),
    "gzip that is hardly smaller": ({"Content-Encoding": "gzip"}, partial(gzip.compress, compresslevel=0)),
    "gzip, not announced to the page": ({"Content-Encoding": "gzip", "X-Hidden": "1"}, gzip.compress),
    "deflate, not announced to the page": ({"Content-Encoding": "deflate", "X-Hidden": "1"}, zlib.compress),
    "an encoding of nothing": ({"Content-Encoding": "identity"}, lambda body: body),
}  # fmt: skip


def test_progress_stays_within_its_total(page: Any, site: WebSite) -> None:
    """Also where a page cannot see that the answer is packed, as with other origins."""
    names = [*"xyz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    names += [f"rot_{part}" for part in range(4)]
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 70000"]
    header = "\n".join([*lines, *(f"property float {name}" for name in names), "end_header\n"])
    body = header.encode() + bytes(70_000 * 4 * len(names))
    for number, (headers, packed) in enumerate(_ANSWERS.values()):
        site.contents[f"/{number}.ply"] = packed(body)
        site.headers[f"/{number}.ply"] = headers
    results = page.evaluate(
        """async (count) => {
          delete window.Worker; // whose headers the page would not change
          for (const name of ["has", "get"]) {
            const own = Headers.prototype[name];
            Headers.prototype[name] = function (header) {
              const isHidden = header === "Content-Encoding" && own.call(this, "X-Hidden");
              return isHidden ? (name === "has" ? false : null) : own.call(this, header);
            };
          }
          const results = [];
          for (let number = 0; number < count; number++) {
            const element = made({ src: `${number}.ply`, loading: "eager" });
            const bar = element.shadowRoot.querySelector("[role=progressbar]");
            const progress = [];
            element.addEventListener("progress", ({ detail: { loaded, total } }) => {
              progress.push([loaded, total, parseFloat(bar.style.width)]);
            });
            await element.ready.catch(() => {});
            results.push(progress);
            element.remove();
          }
          return results;
        }""",
        len(_ANSWERS),
    )
    for name, progress in zip(_ANSWERS, results, strict=True):
        assert progress[-1][0] == len(body), name
        assert all(total == 0 or loaded <= total for loaded, total, _ in progress), name
        assert all(width <= 100 for *_, width in progress), name
    assert results[0][-1][1] == len(body)


def test_each_whole_number_lasts_as_long(page: Any) -> None:
    shown, set_to = page.evaluate(
        """async () => {
          const { Playback } = await import("/client/playback.js");
          const playback = new Playback({ low: 2, high: 5, seconds: 4, loop: true, isWhole: true });
          const shown = [0, 0.99, 1, 1.99, 2, 3, 3.99, 4].map((seconds) => {
            playback.currentTime = seconds;
            return playback.value;
          });
          playback.value = 4;
          return [shown, [playback.currentTime, playback.value]];
        }"""
    )
    assert shown == [2, 2, 3, 3, 4, 5, 5, 5]
    assert set_to == [2, 4]


def test_media_properties_work_before_and_after_loading(page: Any) -> None:
    """As those of `<video>` do; the model is a knot that is given a time."""
    result = page.evaluate(
        """async () => {
          const element = made({ loop: "" });
          element.currentTime = 1.5;
          element.playbackRate = 2;
          element.play();
          const before = [element.currentTime, element.paused, element.duration];
          const { Playback } = await import("/client/playback.js");
          element.src = "knot.spz";
          await element.ready;
          const playback = new Playback({ low: 0, high: 1, seconds: 2, loop: false });
          element._wish = { time: 1.5, plays: true };
          element._startTime(playback);
          element._shown.playback = playback;
          const after = [element.currentTime, element.paused, element.duration, playback.loop];
          const advanced = (seconds) => {
            playback.play();
            playback.advance(1000);
            playback.advance(1000 + 1000 * seconds);
            return [playback.currentTime, playback.paused];
          };
          const looped = advanced(0.5);
          element.loop = false;
          const ended = [...advanced(0.9), element.ended];
          element.playbackRate = -1;
          element.currentTime = 0.25;
          const back = advanced(0.5);
          element.currentTime = 99;
          const clamped = element.currentTime;
          return { before, after, looped, ended, back, clamped };
        }"""
    )
    assert result == {
        "before": [1.5, False, 0],
        "after": [1.5, False, 2, True],
        "looped": [0.5, False],
        "ended": [2, True, True],
        "back": [0, True],
        "clamped": 2,
    }


def test_pictures_are_drawn_in_any_size_and_transparent(page: Any) -> None:
    result = page.evaluate(
        """async () => {
          const element = made({ src: "knot.spz", background: "transparent" });
          const blob = await element.toBlob({ width: 90, height: 30 });
          const bitmap = await createImageBitmap(blob);
          const canvas = new OffscreenCanvas(90, 30);
          const context = canvas.getContext("2d");
          context.drawImage(bitmap, 0, 0);
          const { data } = context.getImageData(0, 0, 90, 30);
          const alphas = data.filter((_, index) => index % 4 === 3);
          element.background = "rgb(255 0 0)";
          const red = await createImageBitmap(await element.toBlob({ type: "image/png" }));
          context.drawImage(red, 0, 0);
          return {
            size: [bitmap.width, bitmap.height, blob.type], own: [red.width, red.height],
            corner: [data[3], ...context.getImageData(0, 0, 1, 1).data], least: Math.min(...alphas), most: Math.max(...alphas),
            host: getComputedStyle(element).backgroundColor,
          };
        }"""
    )
    assert result["size"] == [90, 30, "image/png"]
    assert result["own"] == [64, 48]
    assert result["corner"] == [0, 255, 0, 0, 255]
    assert result["least"] == 0
    assert result["most"] > 200
    assert result["host"] == "rgba(0, 0, 0, 0)"


def test_what_is_under_a_pixel_is_found(page: Any) -> None:
    """Points lie within the box and project to where they were picked; the background is null."""
    result = page.evaluate(
        """async () => {
          const element = made({ src: "knot.spz", style: "width: 128px; height: 96px" });
          await element.ready;
          await until(() => element.camera?.width === 128);
          const { camera } = element;
          const box = element.getBoundingBox();
          const found = [];
          for (let x = 4; x < 128; x += 4) for (let y = 4; y < 96; y += 4) {
            const hit = await element.pick(x, y);
            if (hit) found.push([x, y, hit.point, hit.normal, hit.model === element]);
          }
          return { camera, box, found, corner: await element.pick(1, 1), outside: await element.pick(-5, 5) };
        }"""
    )
    camera = result["camera"]
    view = np.array(camera["view"]).reshape(4, 4)
    low, high = np.array(result["box"]["min"]), np.array(result["box"]["max"])
    assert len(result["found"]) >= 5
    for x, y, point, normal, is_model in result["found"]:
        right, down, ahead = view[:3, :3] @ point + view[:3, 3]
        assert camera["cx"] + camera["fx"] * right / ahead == pytest.approx(x)
        assert camera["cy"] + camera["fy"] * down / ahead == pytest.approx(y)
        assert (point > low - 0.5 * (high - low)).all()
        assert (point < high + 0.5 * (high - low)).all()
        assert normal is None or np.linalg.norm(normal) == pytest.approx(1)
        assert is_model
    assert result["corner"] is None
    assert result["outside"] is None


def test_the_camera_is_read_set_and_limited(page: Any) -> None:
    result = page.evaluate(
        """async () => {
          const element = made({ src: "knot.spz", "camera-orbit": "40 10 5", "camera-target": "0 1 0", "field-of-view": "60" });
          await element.ready;
          const rounded = ({ azimuth, elevation, radius, target, fieldOfView }) =>
            [azimuth, elevation, radius, ...target, fieldOfView].map((number) => Math.round(1e6 * number) / 1e6 + 0);
          const first = rounded(element.orbit);
          element.orbit = { azimuth: -170, elevation: 45 };
          const moved = rounded(element.orbit);
          const { camera, orbit } = element;
          element.orbit = element.orbit;
          const same = rounded(element.orbit);
          await until(() => !element._frameRequest && !element._isDrawing);
          const seen = element.camera;
          element.orbit = { azimuth: 10, elevation: 0 };
          element.camera = seen;
          const restored = rounded(element.orbit);
          element.fieldOfView = 20;
          const lens = rounded(element.orbit);
          element.minCameraOrbit = "-30 0 4";
          element.maxCameraOrbit = "30 30 6";
          const limited = rounded(element.orbit);
          element.orbit = { azimuth: 0, elevation: 80, radius: 100 };
          const held = rounded(element.orbit);
          element._shown.orbit.orbit(-3, 0);
          const dragged = rounded(element.orbit);
          element.resetCamera();
          const home = rounded(element.orbit);
          element.removeAttribute("min-camera-orbit");
          element.removeAttribute("max-camera-orbit");
          element.autoRotate = true;
          element.rotationPerSecond = 90;
          await until(() => Math.abs(element.orbit.azimuth - home[0]) > 5);
          return { first, moved, same, restored, lens, limited, held, dragged: dragged.slice(0, 3), home };
        }"""
    )
    assert result["first"] == [40, 10, 5, 0, 1, 0, 60]
    assert result["moved"] == [-170, 45, 5, 0, 1, 0, 60]
    assert result["same"] == result["restored"] == result["moved"]
    assert result["lens"] == [-170, 45, 5, 0, 1, 0, 20]
    assert result["limited"] == [-30, 30, 5, 0, 1, 0, 20]
    assert result["held"] == [0, 30, 6, 0, 1, 0, 20]
    assert result["dragged"][0] in (-30, 30)
    assert result["home"] == [30, 10, 5, 0, 1, 0, 20]


def test_the_guides_elements_are_shown(page: Any, site: WebSite, knot: bytes) -> None:
    guide = (ROOT / "docs/guides/models-in-a-page.md").read_text("utf-8")
    elements = re.findall(r"```html\n(<gsgen-model.*?)```", guide, re.DOTALL)
    elements = [element for element in elements if "posts=" not in element]
    site.contents["/room.spz"] = site.contents["/room.ply"] = knot  # there is no room.sog
    shown = page.evaluate(
        """async (elements) => {
          document.body.innerHTML = elements.join("");
          const models = [...document.querySelectorAll("gsgen-model")];
          await Promise.all(models.map(({ ready }) => ready));
          return models.map(({ currentSrc, warnings, _annotations }) =>
            [currentSrc.replace(location.origin, ""), warnings, _annotations._entries.length]);
        }""",
        elements,
    )
    assert shown == [["/room.ply", [], 0], ["/room.spz", [], 1]]


def test_annotations_stand_at_their_points(page: Any) -> None:
    result = page.evaluate(
        """async () => {
          const element = made({ src: "knot.spz", "camera-orbit": "0 0 10" });
          const add = (slot, position, normal) => {
            const button = document.createElement("button");
            Object.assign(button, { slot, textContent: slot });
            Object.assign(button.dataset, { position, ...(normal ? { normal } : {}) });
            element.append(button);
            return button;
          };
          await element.ready;
          const { center } = element._shown.model.extent;
          const eye = element._shown.orbit.eye;
          const to = eye.map((part, axis) => part - center[axis]);
          const at = (share) => center.map((part, axis) => part + share * to[axis]).join(" ");
          const middle = add("annotation-middle", at(0), to.join(" "));
          const behind = add("annotation-behind", at(2));
          const away = add("annotation-away", at(0), to.map((part) => -part).join(" "));
          await until(() => middle.getBoundingClientRect().width);
          await pause(100);
          const box = element.getBoundingClientRect();
          const mid = middle.getBoundingClientRect();
          const shown = [middle, behind, away].map((button) => button.getBoundingClientRect().width > 0);
          return { offset: [mid.x + mid.width / 2 - box.x - box.width / 2, mid.y + mid.height / 2 - box.y - box.height / 2], shown };
        }"""
    )
    assert result["offset"] == pytest.approx([0, 0], abs=1)
    assert result["shown"] == [True, False, False]


def test_an_element_moves_into_another_document(page: Any) -> None:
    """With its style, which documents do not share, and its model."""
    result = page.evaluate(
        """async () => {
          const frame = document.createElement("iframe");
          document.body.append(frame);
          const element = made({ src: "knot.spz" });
          await element.ready;
          frame.contentDocument.body.append(element);
          await pause(100);
          const canvas = element.shadowRoot.querySelector("canvas");
          const position = frame.contentWindow.getComputedStyle(canvas).position;
          return [element.state, position, Boolean(element._shown)];
        }"""
    )
    assert result == ["ready", "absolute", True]


def test_a_picture_of_an_element_out_of_view_loads_it(page: Any) -> None:
    sizes = page.evaluate(
        """async () => {
          const far = made({ src: "knot.spz", style: "position: absolute; top: 9000px" });
          const { type, size } = await far.toBlob({ width: 20, height: 10 });
          const none = await made().toBlob().catch(({ message }) => message);
          far.remove();
          const removed = await far.toBlob().catch(({ message }) => message);
          return [type, size > 100, none, removed];
        }"""
    )
    message = "toBlob(): there is no model in this document"
    assert sizes == ["image/png", True, message, message]


_SWIPES = {
    # A finger's way in pixels, and whether the camera turns in place of the page's scrolling.
    "a tap": ((2, 2), False),
    "up": ((0, -60), False),
    "down": ((0, 60), False),
    "steeply up": ((15, -60), False),
    "steeply down": ((-15, 60), False),
    "right": ((60, 0), True),
    "left": ((-60, 0), True),
    "flatly right": ((60, 20), True),
    "flatly left": ((-60, -20), True),
}


def test_a_vertical_swipe_scrolls_and_a_horizontal_one_turns(
    browser: Any, page: Any, site: WebSite
) -> None:
    context = browser.new_context(viewport={"width": 300, "height": 300}, has_touch=True)
    phone = context.new_page()
    phone.set_default_timeout(60_000)
    phone.goto(f"{site.address}/states.html")
    phone.wait_for_function("Boolean(customElements.get('gsgen-model'))")
    style = "width: 300px; height: 280px; margin: 100px 0 2000px"
    phone.evaluate("""(style) => {
      window.element = made({ src: "knot.spz", "camera-controls": "", style });
      return element.ready.then(() => null);
    }""", style)  # fmt: skip
    touch = context.new_cdp_session(phone)
    turned, scrolled = {}, {}
    for name, ((right, down), _) in _SWIPES.items():
        phone.evaluate("scrollTo(0, 100)")
        before = phone.evaluate("element.orbit")
        for share in range(7):
            kind = "touchMove" if share else "touchStart"
            points = [{"x": 150 + right * share / 6, "y": 150 + down * share / 6, "id": 0}]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        phone.wait_for_timeout(150)  # a finger that rests leaves no momentum
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        after = phone.evaluate("element.orbit")
        turned[name] = (
            before["azimuth"] != after["azimuth"] or before["elevation"] != after["elevation"]
        )
        scrolled[name] = phone.evaluate("scrollY") != 100
    context.close()
    assert scrolled == {
        name: abs(way[1]) > 2 and not turns for name, (way, turns) in _SWIPES.items()
    }
    assert turned == {name: turns for name, (_, turns) in _SWIPES.items()}
