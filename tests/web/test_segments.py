"""Clips in pages: segments are fetched as time goes on, and drawn as Python draws them."""

import json
import threading
import wave
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest

from gsgen.formats import write_ply
from gsgen.reference_plugins.sequences.synthetic_sequence import write_sequence
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.web.pages import ModelView, single_file_page
from gsgen.runtime.web.serving import ModelServer
from gsgen.tiles.serving.server import serve_folder
from support.commands import gsgen_here
from support.web.pages import WebSite
from support.web.scene_pages import HEIGHT, WIDTH, decibels, picture, rendered, shown

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("ort")]

_PAGE = f"""<!doctype html><meta charset=utf-8>
  <style>gsgen-scene {{ width: {WIDTH}px; height: {HEIGHT}px; aspect-ratio: auto }}</style>
  <script type=module src=/client/scene.js></script><body></body>""".encode()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip of four segments, the first of them a still, and a splat file."""
    folder = tmp_path_factory.mktemp("clips")
    write_sequence(folder / "frames", rows=400, frames=10)
    write_ply(folder / "still.ply", torus_knot(300, degree=1))
    arguments = ("export", "sequence", str(folder / "frames"), "-o", str(folder / "clip.json"))
    options = ("--fps", "10", "--segment", "0.3", "--loop", "--level", "static", "--moments", "0")
    ran = gsgen_here(*arguments, *options)
    assert ran.code == 0, ran.err
    return folder


@pytest.fixture
def page(site: WebSite, folder: Path) -> Any:
    for path in folder.rglob("*"):
        if path.is_file():
            site.contents[f"/{path.relative_to(folder).as_posix()}"] = path.read_bytes()
    site.contents["/scenes.html"] = _PAGE
    site.open("/scenes.html")
    site.page.wait_for_function("Boolean(customElements.get('gsgen-scene'))")
    return site.page


def test_two_clips_and_a_still_are_drawn_as_in_python_and_fetched_as_time_goes_on(
    page: Any, site: WebSite, folder: Path, renderer: Renderer
) -> None:
    segments = [
        {"path": f"clip/000{number}.{'onnx' if number else 'sog'}", "seconds": seconds}
        for number, seconds in enumerate((0.1, 0.3, 0.3, 0.3))
    ]
    camera = Camera.look_at([0.4, -1.2, -7.0], [0, 0, 0], width=WIDTH, height=HEIGHT, fov_y=40)
    document = {
        "models": [
            {"path": "still.ply", "translate": [0, 1.5, 0.5], "scale": 0.6},
            {"segments": segments, "capacity": 400},
            {"path": "clip/0002.onnx", "translate": [-1.5, 0, 1]},
        ],
        "camera": {"view": camera.view.tolist(), "fx": camera.fx, "fy": camera.fy}
        | {"cx": camera.cx, "cy": camera.cy, "width": WIDTH, "height": HEIGHT},
        "timeline": {"seconds": 1, "fps": 4},
    }
    site.requests.clear()
    result = shown(site, document)
    assert result["errors"] == result["warnings"] == []
    assert result["duration"] == 1
    assert "/clip/0000.sog" in site.requests
    assert "/clip/0003.onnx" not in site.requests
    images = rendered(folder, document, renderer, frames=5)  # at 0, 0.25, 0.5, 0.75 and 1 seconds
    for number in (0, 1, 3, 4, 2):
        assert decibels(picture(page, number / 4), images[number]) >= 60
    assert np.abs(images[0] - images[2]).max() > 0.2
    opened = page.evaluate(
        "[...document.querySelector('gsgen-scene').stage.entries[1].model._opened.keys()]"
    )
    assert len(opened) == 2
    assert [error for error in site.errors if error.startswith("page:")] == []


def test_a_later_segment_above_the_capacity_is_named(page: Any, site: WebSite) -> None:
    """The first one is a file of few Gaussians."""
    segments = [
        {"path": path, "seconds": 1} for path in ("still.ply", "clip/0001.onnx", "still.ply")
    ]
    result = shown(site, {"models": [{"segments": segments, "capacity": 300}]})
    assert result["errors"] == []
    error = page.evaluate(
        """() => {
          const { _shown: shown } = document.querySelector("gsgen-scene");
          return shown.model.entries[0].model.update({ time: 1.5 }, shown.orbit.camera(96, 64)).catch(String);
        }"""
    )
    assert "clip/0001.onnx: has 400 Gaussians, expected at most 300" in error


def test_segments_play_from_the_server_of_tiles(page: Any, site: WebSite, folder: Path) -> None:
    """From another origin, segment by segment."""
    document = json.loads((folder / "clip.json").read_text("utf-8"))
    local = shown(site, document)
    expected = picture(page, 0.5)
    log: list[str] = []
    with serve_folder(folder, log=log.append, cors=[site.address]) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        for segment in document["models"][0]["segments"]:
            segment["path"] = server.address + segment["path"]
        assert shown(site, document) == local
        assert not any("0003.onnx" in line for line in log)
        np.testing.assert_array_equal(picture(page, 0.5), expected)
        server.shutdown()
    assert {"200 /clip/0000.sog", "200 /clip/0002.onnx"} <= set(log)


_SOUND = "document.querySelector('gsgen-scene').shadowRoot.querySelector('video')"
_SEEKS = f"""async () => {{
  let seeks = 0;
  {_SOUND}.addEventListener("seeked", () => seeks++);
  for (let frame = 0; frame < 5; frame++) {{
    document.querySelector("gsgen-scene").currentTime = 1.76543219876;
    await new Promise((resolve) => setTimeout(resolve, 100));
  }}
  return seeks;
}}"""


def spoken(folder: Path) -> dict[str, Any]:
    """Write a recording of three seconds and its captions, and return a scene with them."""
    with wave.open(str(folder / "speech.wav"), "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        file.writeframes(np.int16(9000 * np.sin(np.arange(3 * 8000) / 3)).tobytes())
    (folder / "speech.vtt").write_text("WEBVTT\n\n00:00.800 --> 00:02.900\nIt bends.\n")
    sound = {"path": "speech.wav", "start": 0.5, "captions": "speech.vtt"}
    return {"models": [{"path": "still.ply"}], "timeline": {"seconds": 4}, "sound": sound}


def test_sound_follows_the_clock_with_captions(page: Any, site: WebSite, folder: Path) -> None:
    """Silent until a gesture, at its place after seeking, and paused with the clock or without it."""
    document = spoken(folder)
    for name in ("speech.wav", "speech.vtt"):
        site.contents[f"/{name}"] = (folder / name).read_bytes()
    # Playwright's calls count as gestures of a visitor.
    page.evaluate("Object.defineProperty(navigator, 'userActivation', { value: {} })")
    assert shown(site, document)["warnings"] == []
    page.wait_for_function(f"{_SOUND}?.readyState >= 2")
    assert page.evaluate(f"[{_SOUND}.muted, {_SOUND}.paused, {_SOUND}.currentTime]") == [
        True,
        True,
        0,
    ]
    page.evaluate("document.querySelector('gsgen-scene').currentTime = 1.5")
    page.wait_for_function(f"{_SOUND}.textTracks[0].activeCues?.[0]?.text === 'It bends.'")
    assert page.evaluate(f"{_SOUND}.currentTime") == 1
    # Browsers round times to microseconds: a clock at rest needs one seek.
    assert page.evaluate(_SEEKS) == 1
    page.mouse.click(WIDTH / 2, HEIGHT / 2)
    assert page.evaluate(f"{_SOUND}.muted") is False
    page.evaluate("document.querySelector('gsgen-scene').play()")
    page.wait_for_function(f"{_SOUND}.currentTime > 1.3")
    drift = f"document.querySelector('gsgen-scene').currentTime - 0.5 - {_SOUND}.currentTime"
    assert abs(page.evaluate(drift)) < 0.5
    page.evaluate("document.querySelector('gsgen-scene').pause()")
    assert page.evaluate(f"{_SOUND}.paused") is True
    page.evaluate(
        "const scene = document.querySelector('gsgen-scene'); scene.loop = true; scene.play()"
    )
    page.wait_for_function(f"!{_SOUND}.paused")
    page.evaluate("document.querySelector('gsgen-scene').style.display = 'none'")
    page.wait_for_function(f"{_SOUND}.paused")  # without frames there is no clock
    for recording, message in ((b"no sound", "cannot be played"), (None, "cannot be loaded: 404")):
        page.evaluate("document.body.replaceChildren()")
        site.contents.pop("/speech.wav")
        if recording:
            site.contents["/speech.wav"] = recording
        assert shown(site, document)["errors"] == []
        page.wait_for_function("document.querySelector('gsgen-scene').warnings.length")
        warning = page.evaluate("document.querySelector('gsgen-scene').warnings[0]")
        assert warning["where"] == "sound"
        assert message in warning["message"]


def test_pages_bring_the_sound_of_a_scene_file(page: Any, site: WebSite, folder: Path) -> None:
    """In one file, and from the server of `view --web`."""
    scene = folder / "spoken.json"
    scene.write_text(json.dumps(spoken(folder)), "utf-8")
    site.contents["/single.html"] = single_file_page([scene], ModelView(play=False), None).encode()
    site.open("/single.html")
    page.wait_for_function(f"document.querySelector('gsgen-scene') && {_SOUND}?.duration === 3")
    assert page.evaluate(f"{_SOUND}.textTracks.length") == 1
    with ModelServer([scene], ModelView(), ort=None) as server:
        served = server.content("/models/0/spoken.json")
        assert served is not None
        sound = json.loads(served[1])["sound"]
        assert sound["start"] == 0.5
        for field, name in (("path", "speech.wav"), ("captions", "speech.vtt")):
            file = server.content(unquote(sound[field].partition("?")[0]))
            assert file is not None
            assert file[1] == (folder / name).read_bytes()
