"""Attributes and properties of `<gsgen-model>`: parsed as HTML and CSS do, and what is wrong is told."""

from typing import Any

import pytest

from gsgen.formats import write_spz
from gsgen.reference_plugins.writing.knot import torus_knot
from support.web.pages import WebSite

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(site: WebSite, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a page with the element's class, and a small model."""
    path = tmp_path_factory.mktemp("knot") / "knot.spz"
    write_spz(path, torus_knot(300, degree=0))
    site.contents["/knot.spz"] = path.read_bytes()
    site.contents["/attributes.html"] = b"""<!doctype html><meta charset=utf-8>
      <style>:root { --brand: rgb(0 128 0) } body { color: rgb(0 0 255) }
        gsgen-model { width: 64px; height: 48px; aspect-ratio: auto }</style>
      <script type=module src=/client/gsgen.js></script>"""
    site.open("/attributes.html")
    site.page.wait_for_function("Boolean(customElements.get('gsgen-model'))")
    return site.page


_PARSED = [
    # attribute, text, property, its value, how many warnings
    ("src", "a/b.ply", "src", "HOST/a/b.ply", 0),
    ("src", "  b.ply ", "src", "HOST/b.ply", 0),
    ("src", "", "src", "", 1),
    ("poster", "../p.png", "poster", "HOST/p.png", 0),
    ("alt", " A knot ", "alt", " A knot ", 0),
    ("loading", "EAGER", "loading", "eager", 0),
    ("loading", "now", "loading", "lazy", 1),
    ("autoplay", "", "autoplay", True, 0),
    ("loop", "loop", "loop", True, 0),
    ("loop", "false", "loop", True, 1),
    ("camera-controls", "off", "cameraControls", True, 1),
    ("field-of-view", "40", "fieldOfView", 40, 0),
    ("field-of-view", "40deg", "fieldOfView", 40, 0),
    ("field-of-view", "0.25turn", "fieldOfView", 90, 0),
    ("field-of-view", "4e1", "fieldOfView", 40, 0),
    ("field-of-view", "300", "fieldOfView", 170, 1),
    ("field-of-view", "-5", "fieldOfView", 1, 1),
    ("field-of-view", "wide", "fieldOfView", 50, 1),
    ("field-of-view", "NaN", "fieldOfView", 50, 1),
    ("field-of-view", "40px", "fieldOfView", 50, 1),
    ("mode", "Depth", "mode", "depth", 0),
    ("mode", "bogus", "mode", "color", 1),
    ("mode", "", "mode", "color", 1),
    ("up", "-Y", "up", "-y", 0),
    ("up", "q", "up", "", 1),
    ("up", "0 1 0", "up", "", 1),
    ("time", "0.5", "time", 0.5, 0),
    ("time", "half", "time", None, 1),
    ("time", "1e999", "time", None, 1),
    ("target", "visionary", "target", "visionary", 0),
    ("target", "chrome", "target", "webgpu", 1),
    ("max-error", "0", "maxError", 0.01, 1),
    ("max-splats", "5000.4", "maxSplats", 5000, 1),
    ("max-splats", "1e6", "maxSplats", 1_000_000, 0),
    ("camera-orbit", "30deg 20deg 4m", "cameraOrbit", "30deg 20deg 4m", 0),
    ("camera-orbit", "auto", "cameraOrbit", "auto", 0),
    ("camera-orbit", "30, auto, 2", "cameraOrbit", "30, auto, 2", 0),
    ("camera-orbit", "30 20 -4", "cameraOrbit", "30 20 -4", 1),
    ("camera-orbit", "30 20 0", "cameraOrbit", "30 20 0", 1),
    ("camera-orbit", "1 2 3 4", "cameraOrbit", "1 2 3 4", 1),
    ("camera-orbit", "north", "cameraOrbit", "north", 1),
    ("camera-target", "1 2 x", "cameraTarget", "1 2 x", 1),
    ("min-camera-orbit", "auto 0 1", "minCameraOrbit", "auto 0 1", 0),
    ("rotation-per-second", "1rad", "rotationPerSecond", 57.29577951308232, 0),
    ("background", "white", "background", "white", 0),
    ("background", "whitish", "background", "whitish", 1),
    ("background", "#12", "background", "#12", 1),
    ("background", "255 255 255", "background", "255 255 255", 1),
]


def test_attributes_are_parsed_as_html_and_css_parse_them(site: WebSite, page: Any) -> None:
    results = page.evaluate(
        """(cases) => cases.map(([attribute, text, property]) => {
          const element = document.createElement("gsgen-model");
          element.setAttribute(attribute, text);
          return [element[property], element.warnings.length];
        })""",
        _PARSED,
    )
    for (attribute, text, _, value, count), result in zip(_PARSED, results, strict=True):
        expected = value.replace("HOST", site.address) if isinstance(value, str) else value
        assert result == [expected, count], (attribute, text)


def test_every_property_reflects_its_attribute(page: Any) -> None:
    """Set and cleared again, for all attributes at once."""
    wrong = page.evaluate(
        """async () => {
          const { ATTRIBUTES, propertyOf } = await import("/client/attributes.js");
          const element = document.createElement("gsgen-model");
          const wrong = [];
          const samples = {
            "camera-orbit": [1, 2, 3], "camera-target": [1, 2, 3], "min-camera-orbit": [1, 2, 3],
            "max-camera-orbit": [1, 2, 3], background: "red", mode: "depth", up: "-z",
            loading: "eager", target: "core", time: 2, "max-error": 2, "max-splats": 5000,
            "field-of-view": 70, "rotation-per-second": 5, "min-render-scale": 0.8,
          };
          for (const [name, { reflects }] of Object.entries(ATTRIBUTES)) {
            const property = propertyOf(name);
            const first = element[property];
            const value = samples[name] ?? (reflects === "presence" ? true : "x");
            element[property] = value;
            const written = element.getAttribute(name);
            if (written !== (value === true ? "" : String(value))) wrong.push([name, written]);
            if (element[property] === first) wrong.push([name, "unchanged"]);
            for (const none of [null, undefined]) {
              element[property] = value;
              element[property] = reflects === "presence" ? false : none;
              if (element.hasAttribute(name) || element[property] !== first) wrong.push([name, none]);
            }
          }
          return [wrong, element.warnings];
        }"""
    )
    assert wrong == [[], []]


_COLORS = {
    "white": [1, 1, 1, 1],
    "#fff": [1, 1, 1, 1],
    "#FF000080": [1, 0, 0, 128 / 255],
    "transparent": [0, 0, 0, 0],
    "rgb(51 102 153)": [0.2, 0.4, 0.6, 1],
    "rgba(51, 102, 153, 20%)": [0.2, 0.4, 0.6, 0.2],
    "hsl(120 100% 50%)": [0, 1, 0, 1],
    "color(srgb 0.1 0.2 0.3 / 0.4)": [0.1, 0.2, 0.3, 0.4],
    "color(srgb 2 -1 none)": [1, 0, 0, 1],
    "var(--brand)": [0, 128 / 255, 0, 1],
    "currentColor": [1, 1, 1, 1],  # the element's own text is white
    "0.1 0.2 0.3": [0.1, 0.2, 0.3, 1],
    "0.1, 0.2, 0.3": [0.1, 0.2, 0.3, 1],
    "255 0 0": [1, 0, 0, 1],
    "nothing": [0, 0, 0, 1],
}


def test_a_background_is_a_colour_of_css(page: Any) -> None:
    results = page.evaluate(
        """(colors) => colors.map((color) => {
          const element = document.createElement("gsgen-model");
          element.background = color;
          document.body.append(element);
          const { background } = element._look();
          element.remove();
          return background;
        })""",
        list(_COLORS),
    )
    for (color, expected), result in zip(_COLORS.items(), results, strict=True):
        assert result == pytest.approx(expected, abs=1e-6), color


_MISUSES = [
    # What a page does with an element that shows a knot, and what it is told.
    ("element.background = 'blakc'", 'background "blakc" is no colour of CSS'),
    ("element.fieldOfView = 300", 'field-of-view "300" is not a number from 1 to 170'),
    ("element.fieldOfView = NaN", 'field-of-view "NaN" is not a number from 1 to 170'),
    ("element.mode = 'wireframe'", 'mode "wireframe" is none of color, depth'),
    ("element.up = 'up'", 'up "up" is none of x, y, z'),
    ("element.loading = 'auto'", 'loading "auto" is none of lazy, eager'),
    ("element.setAttribute('autoplay', 'false')", 'autoplay "false" is on'),
    ("element.cameraOrbit = '30,20,close'", 'camera-orbit "30,20,close" is not azimuth, elevation'),
    ("element.cameraTarget = [1, 2, 'z']", 'camera-target "1,2,z" is not a point x y z'),
    ("element.time = 'noon'", 'time "noon" is not a number'),
    ("element.target = 'cuda'", 'target "cuda" is none of webgpu'),
    ("element.maxSplats = 100", 'max-splats "100" is not a whole number from 4096'),
    ("element.maxError = 'low'", 'max-error "low" is not a number from 0.01'),
    ("element.currentTime = 'end'", 'currentTime is "end", expected a finite number'),
    ("element.currentTime = undefined", "currentTime is undefined, expected a finite number"),
    ("element.playbackRate = Infinity", "playbackRate is Infinity, expected a finite number"),
    ("element.play()", "play() does nothing: the model has no time"),
    ("element.inputs = 5", "inputs is 5, expected values by name"),
    ("element.inputs = [1, 2]", "inputs is [1,2], expected values by name"),
    ("element.inputs = { speed: 2 }", "inputs.speed is no input of the model. It has none."),
    ("element.inputs.speed = 2", "inputs.speed is no input of the model. It has none."),
    ("element.lookAt(1, 2, 3)", "lookAt() got 1, expected a point [x, y, z]"),
    ("element.lookAt({ x: 1, y: 2, z: 3 })", 'lookAt() got {"x":1,"y":2,"z":3}, expected a point'),
    ("element.orbit = { theta: 1 }", "orbit has none of azimuth, elevation, radius"),
    ("element.orbit = { radius: 0 }", "orbit.radius is 0, which no camera has"),
    ("element.orbit = { azimuth: '30deg' }", 'orbit.azimuth is "30deg", which no camera has'),
    ("element.orbit = null", "orbit has none of azimuth"),
    ("element.camera = { position: [1, 2, 3] }", "orbit has none of azimuth"),
    ("element.pick({ clientX: 1 })", 'pick(x, y) is {"clientX":1}, expected a finite number'),
    ("element.setAttribute('camera-control', '')", "camera-control is no attribute"),
    ("element.setAttribute('auto-play', '')", "auto-play is no attribute; is autoplay meant?"),
    ("element.backgroundd = 'red'", "backgroundd is no property; is background meant?"),
    (
        "element.innerHTML = '<p slot=annotation-1 data-position=top>A</p>'",
        'annotation-1 has data-position="top", expected x y z',
    ),
    ("element.toBlob({ width: 0 })", "toBlob(): is 0×48, expected whole numbers from 1 to"),
    ("element.toBlob({ type: 'image/tga' })", "the browser encodes no image/tga"),
]


def test_natural_misuses_are_told_by_one_sentence(page: Any) -> None:
    """Once in the console, once by an event, and in `warnings`; promises are rejected instead."""
    lines: list[str] = []
    page.on("console", lambda message: lines.append(message.text))
    results = page.evaluate(
        """async (misuses) => {
          const element = document.createElement("gsgen-model");
          element.src = "/knot.spz";
          document.body.append(element);
          await element.ready;
          const results = [];
          for (const misuse of misuses) {
            const told = [];
            const listen = ({ detail }) => told.push(`${detail.where} ${detail.message}`);
            element.warnings.length = 0;
            element.addEventListener("warning", listen);
            try {
              await new Function("element", `return ${misuse}`)(element);
            } catch (error) {
              told.push(error.message);
            }
            // Names are looked at when an element is connected.
            document.body.append(element);
            await new Promise((resolve) => setTimeout(resolve));
            element.removeEventListener("warning", listen);
            results.push(told);
            for (const name of element.getAttributeNames()) if (name !== "src") element.removeAttribute(name);
            delete element.backgroundd;
            element.replaceChildren();
            element.inputs = {};
          }
          const { state } = element;
          element.remove();
          return [results, state];
        }""",
        [misuse for misuse, _ in _MISUSES],
    )
    told, state = results
    assert len(_MISUSES) >= 30
    for (misuse, expected), sentences in zip(_MISUSES, told, strict=True):
        assert len(sentences) == 1, (misuse, sentences)
        assert expected in sentences[0], misuse
    assert state == "ready"
    assert len([line for line in lines if line.startswith("gsgen-model: ")]) == len(_MISUSES) - 2


def test_a_poster_that_cannot_be_shown_is_told(page: Any) -> None:
    warning = page.evaluate(
        """async () => {
          const element = document.createElement("gsgen-model");
          element.poster = "/no.png";
          const warned = new Promise((resolve) => element.addEventListener("warning", resolve));
          document.body.append(element);
          const { detail } = await warned;
          element.remove();
          return detail;
        }"""
    )
    assert warning["where"] == "poster"
    assert warning["message"].endswith('/no.png" cannot be shown')


def test_properties_set_before_the_class_is_defined_are_kept(page: Any) -> None:
    """As frameworks set them that render before their modules are loaded."""
    page.evaluate(
        """() => {
          const frame = document.createElement("iframe");
          frame.srcdoc = "<gsgen-model alt=a></gsgen-model>";
          window.loaded = new Promise((resolve) => (frame.onload = () => resolve(frame.contentWindow)));
          document.body.append(frame);
        }"""
    )
    values = page.evaluate(
        """async () => {
          const inner = await window.loaded;
          const element = inner.document.querySelector("gsgen-model");
          Object.assign(element, { src: "/no.spz", cameraControls: true, fieldOfView: 33, currentTime: 2 });
          const script = inner.document.createElement("script");
          script.type = "module";
          script.src = "/client/gsgen.js";
          inner.document.body.append(script);
          await inner.customElements.whenDefined("gsgen-model");
          const attributes = Object.fromEntries(element.getAttributeNames().map((name) => [name, element.getAttribute(name)]));
          const { currentTime } = element;
          inner.frameElement.remove();
          return [attributes, currentTime];
        }"""
    )
    assert values == [
        {"alt": "a", "src": "/no.spz", "camera-controls": "", "field-of-view": "33"},
        2,
    ]
