"""The element `<gsgen-model>` in pages: served by the commands' server, and opened from disk."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.conformance.fixtures import fixtures
from gsgen.formats import write_ply, write_spz
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.web.pages import ModelView, single_file_page
from gsgen.runtime.web.serving import ModelServer
from support.web.pages import WebSite, float32_result, running
from support.web.steady_frames import steady_frames

pytestmark = pytest.mark.slow


_ELEMENT = "document.querySelector('gsgen-model')"


@pytest.fixture(scope="module")
def knot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("knot") / "knot.spz"
    write_spz(path, torus_knot(600, degree=1))
    return path


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": 1000, "height": 380})
    page = context.new_page()
    page.set_default_timeout(90_000)
    yield page
    context.close()


@pytest.fixture(scope="module")
def shown(browser: Any, knot: Path) -> Iterator[Any]:
    """One page with a knot, for tests that leave it usable: loading it takes most of their time."""
    context = browser.new_context(viewport={"width": 1000, "height": 380})
    page = context.new_page()
    page.set_default_timeout(90_000)
    with running(ModelServer([knot], ModelView(), ort=None)) as address:
        page.goto(address)
        wait(page)
        yield page
        context.close()


def wait(page: Any, condition: str = f"{_ELEMENT}.report") -> None:
    page.wait_for_function(condition)


def settled(page: Any) -> None:
    """Wait until no frame is requested or drawn."""
    wait(page, f"!{_ELEMENT}._frameRequest && !{_ELEMENT}._isDrawing")


def errors_of(page: Any) -> list[dict[str, str]]:
    return list(json.loads(page.evaluate(f"JSON.stringify({_ELEMENT}.report.errors)")))


def pixels(page: Any) -> np.ndarray:
    """Return the picture of the element's last frame, as [height, width, 4]."""
    numbers = float32_result(page, f'() => {_ELEMENT}._shown.renderer.readImage("color")')
    width, height = page.evaluate(f"[{_ELEMENT}.camera.width, {_ELEMENT}.camera.height]")
    return numbers.reshape(height, width, 4)


def test_a_served_page_shows_models_and_reloads_them(page: Any, knot: Path, tmp_path: Path) -> None:
    path = tmp_path / "model.spz"
    path.write_bytes(knot.read_bytes())
    view = ModelView(background=(0.1, 0.2, 0.3), fov=40, up="-y")
    with running(ModelServer([path, knot], view, ort=None)) as address:
        page.goto(address)
        wait(page, "[...document.querySelectorAll('gsgen-model')].every((m) => m.report)")
        assert errors_of(page) == []
        image = pixels(page)
        assert (image[..., 3] > 0.5).mean() > 0.01  # a knot …
        np.testing.assert_allclose(image[0, 0, :3], [0.1, 0.2, 0.3], atol=1e-6)  # … before it
        # Both elements share one device, and each has a picture of its own.
        same = "(() => { const [a, b] = document.querySelectorAll('gsgen-model');"
        assert page.evaluate(
            f"{same} return a._shown.renderer.device === b._shown.renderer.device }})()"
        )
        write_spz(path, torus_knot(900, degree=0))
        wait(page, f"{_ELEMENT}._shown?.model.buffers.count === 900")


def test_keys_and_pointers_move_the_camera(shown: Any) -> None:
    before = shown.evaluate(f"{_ELEMENT}.camera.view")
    first = pixels(shown)
    shown.keyboard.press("Tab")
    shown.keyboard.press("ArrowLeft")
    wait(shown, f"{_ELEMENT}.camera.view.join() !== '{','.join(map(str, before))}'")
    settled(shown)
    assert np.abs(pixels(shown) - first).max() > 0.1
    shown.keyboard.press("Home")
    settled(shown)
    np.testing.assert_allclose(shown.evaluate(f"{_ELEMENT}.camera.view"), before, atol=1e-12)
    shown.mouse.move(200, 150)
    shown.mouse.down()
    shown.mouse.move(260, 150, steps=3)
    shown.mouse.up()
    settled(shown)
    assert shown.evaluate(f"{_ELEMENT}.camera.view") != before


def test_the_element_is_described_for_screen_readers(shown: Any) -> None:
    canvas = f"{_ELEMENT}.shadowRoot.querySelector('canvas')"
    assert shown.evaluate(f"{canvas}.getAttribute('role')") == "img"
    assert shown.evaluate(f"{canvas}.getAttribute('aria-label')") == "knot.spz"
    assert shown.evaluate(f"{canvas}.tabIndex") == 0
    status = f"{_ELEMENT}.shadowRoot.querySelector('[role=status]').textContent"
    assert shown.evaluate(status) == "Loaded: knot.spz"


def test_a_page_of_one_file_opens_from_disk(page: Any, knot: Path, tmp_path: Path) -> None:
    ply = tmp_path / "<knot> & co.ply"
    write_ply(ply, torus_knot(400, degree=2))
    file = tmp_path / "page.html"
    file.write_text(single_file_page([knot, ply], ModelView(), None), "utf-8")
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url[:40]))
    page.goto(file.as_uri())
    wait(page, "[...document.querySelectorAll('gsgen-model')].every((m) => m.report)")
    assert errors_of(page) == []
    assert (pixels(page)[..., 3] > 0.5).any()
    assert [url for url in requests if not url.startswith(("data:", "file:"))] == []
    assert page.evaluate("document.title") == "knot.spz, <knot> & co.ply"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no model", "is text that begins 'no model'"),
        (b"\x08\x0a\x3a\xff\x01", "is not a whole ONNX file"),
        (None, "cannot be loaded: 404"),
    ],
)
def test_error_states_its_cause_and_a_hint(
    content: bytes | None, message: str, site: WebSite, page: Any
) -> None:
    site.contents["/error.html"] = b"""<!doctype html><meta charset=utf-8>
      <script type=module src=/client/gsgen.js></script>
      <gsgen-model src="/wrong.ply" alt="Nothing"></gsgen-model>"""
    site.contents.pop("/wrong.ply", None)
    if content is not None:
        site.contents["/wrong.ply"] = content
    page.goto(f"{site.address}/error.html")
    wait(page)
    [error] = errors_of(page)
    assert message in error["message"]
    assert error["hint"]
    alert = f"{_ELEMENT}.shadowRoot.querySelector('[role=alert]')"
    assert message in page.evaluate(f"{alert}.textContent")


def test_a_lost_device_is_opened_again(shown: Any) -> None:
    shown.evaluate(f"{_ELEMENT}._before = {_ELEMENT}._shown.renderer.device; null")
    shown.evaluate(f"{_ELEMENT}._before.destroy()")
    wait(shown, f"{_ELEMENT}._shown && {_ELEMENT}._shown.renderer.device !== {_ELEMENT}._before")
    wait(shown, f"{_ELEMENT}.camera && {_ELEMENT}._shown?.renderer.counts.visible > 0")
    assert errors_of(shown) == []


def test_an_element_removed_in_mid_frame_reports_nothing(page: Any, knot: Path) -> None:
    with running(ModelServer([knot], ModelView(), ort=None)) as address:
        page.goto(address)
        wait(page)
        settled(page)
        reported = page.evaluate(
            f"""async () => {{
              const element = {_ELEMENT};
              const reported = [];
              element.addEventListener("error", ({{ detail }}) => reported.push(detail.message));
              const drawing = [element._draw(0), element.pick(99, 99), element._draw(0)];
              element.remove();
              await Promise.all(drawing);
              await new Promise((resolve) => setTimeout(resolve, 300));
              return [reported, element.state, await element.pick(9, 9)];
            }}"""
        )
        assert reported == [[], "empty", None]


def test_unrecoverable_device_loss_is_reported(page: Any, knot: Path) -> None:
    with running(ModelServer([knot], ModelView(), ort=None)) as address:
        page.goto(address)
        wait(page)
        page.evaluate("navigator.gpu.requestAdapter = async () => null")
        page.evaluate(f"{_ELEMENT}._shown.renderer.device.destroy()")
        wait(page, f"{_ELEMENT}.report.errors.length")
        (error,) = errors_of(page)
        assert error["message"] == "the graphics device was lost"


def test_steady_frames_make_no_gpu_objects_and_wait_for_none(shown: Any) -> None:
    """Of 12 frames of a moving camera, only encoders, passes and command buffers are made."""
    result = steady_frames(shown, 12)
    assert result.made == {}
    assert result.in_flight >= 2
    assert result.heap_growth < 1 << 20


def test_dropped_file_is_validated(shown: Any, tmp_path: Path) -> None:
    [fixture] = [fixture for fixture in fixtures() if fixture.rule == "GM004"][:1]
    model = fixture.write(tmp_path)
    words = shown.evaluate_handle(
        """([name, bytes]) => {
          const transfer = new DataTransfer();
          transfer.items.add(new File([new Uint8Array(bytes)], name));
          return transfer;
        }""",
        ["wrong.onnx", list(model.read_bytes())],
    )
    shown.dispatch_event("gsgen-model", "drop", {"dataTransfer": words})
    wait(shown, f"{_ELEMENT}.report.errors.length")
    [error] = errors_of(shown)
    assert error["rule"] == "GM004"
    assert error["where"] == "wrong.onnx"
    assert "gsgen validate" in error["hint"]
