"""A walking person in an article: the guide's lines, copied between two paragraphs."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.runtime.web.onnxruntime_web import ORT_FILES
from support.browser import serving
from support.commands import ROOT
from support.web.pages import CLIENT, float32_result
from support.web.steady_frames import steady_frames

_GUIDE = ROOT / "docs/guides/models-in-a-page.md"
_ELEMENT = "document.querySelector('gsgen-model')"
_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>An article</title>
<style>body {{ font: 16px/1.5 sans-serif; max-width: 30rem; margin: .5rem auto }}</style>
<h1>Walking</h1>
<p>Models stand between paragraphs, like pictures.</p>
{lines}
<p>The text goes on below.</p>
</html>
"""


@pytest.fixture(scope="module")
def article(browser: Any, ort_folder: Path, walking_person: bytes) -> Iterator[Any]:
    """The page with the model's first frame drawn, its time paused."""
    copied = re.search(r"```html\n(.*?)```", _GUIDE.read_text("utf-8"), re.DOTALL)
    assert copied is not None
    assert copied[1].count("\n") <= 5
    contents = {f"/gsgen/ort/{name}": (ort_folder / name).read_bytes() for name in ORT_FILES}
    contents["/article.html"] = _PAGE.format(lines=copied[1]).encode()
    contents["/walk.onnx"] = walking_person
    with serving({"gsgen": CLIENT}, contents) as address:
        context = browser.new_context(viewport={"width": 360, "height": 340}, has_touch=True)
        page = context.new_page()
        page.set_default_timeout(120_000)
        page.goto(f"{address}/article.html")
        page.wait_for_function(f"{_ELEMENT}.report")
        assert page.evaluate(f"{_ELEMENT}.report.errors") == []
        yield page
        context.close()


def settled(page: Any) -> None:
    """Wait until no frame is requested or drawn."""
    page.wait_for_function(f"!{_ELEMENT}._frameRequest && !{_ELEMENT}._isDrawing")


def test_the_model_plays_until_its_button_is_pressed(article: Any) -> None:
    first = article.evaluate(f"{_ELEMENT}.currentTime")
    article.wait_for_function(f"{_ELEMENT}.currentTime !== {first}")
    article.get_by_role("button", name="Pause").click()
    settled(article)
    assert article.evaluate(f"{_ELEMENT}.paused")
    paused = article.evaluate(f"{_ELEMENT}.currentTime")
    article.keyboard.press("Space")  # the button has the focus, and now starts
    article.get_by_role("button", name="Pause").wait_for()
    article.wait_for_function(f"{_ELEMENT}.currentTime !== {paused}")
    article.keyboard.press("Space")
    settled(article)
    article.get_by_role("button", name="Play").wait_for()


@pytest.mark.slow
def test_canvas_has_a_text_alternative_for_screen_readers(article: Any) -> None:
    canvas = article.get_by_role("img", name="A person walks")
    assert "Arrow keys turn" in canvas.get_attribute("aria-description")
    assert article.get_by_role("status").text_content() == "Loaded: A person walks"
    slider = article.get_by_role("slider", name="Time")
    article.evaluate(f"{_ELEMENT}.currentTime = 0.4")
    assert slider.get_attribute("aria-valuetext") == "0.4 seconds"
    slider.press("ArrowRight")
    article.wait_for_function(f"{_ELEMENT}.currentTime > 0.4")
    settled(article)


@pytest.mark.slow
def test_the_person_stands_upright_and_walks(article: Any, tmp_path: Path) -> None:
    """Three pictures at three times: see them with --basetemp."""
    pictures = []
    for number in range(3):
        article.evaluate(f"{_ELEMENT}.currentTime = {number} * {_ELEMENT}.duration / 3")
        settled(article)
        article.screenshot(path=tmp_path / f"walk-{number}.png")
        numbers = float32_result(article, f'() => {_ELEMENT}._shown.renderer.readImage("color")')
        height, width = article.evaluate(f"[{_ELEMENT}.camera.height, {_ELEMENT}.camera.width]")
        pictures.append(numbers.reshape(height, width, 4))
    view = np.array(article.evaluate(f"{_ELEMENT}.camera.view")).reshape(4, 4)
    assert view[1, :3] @ [0, 1, 0] < -0.9  # the body's y axis points up in the picture
    for picture in pictures:
        rows, columns = np.nonzero(picture[..., 3] > 0.5)
        assert np.ptp(rows) > 1.3 * np.ptp(columns)
        red, green, blue = np.moveaxis(picture[..., :3], 2, 0)
        shirt, shoes = (blue > red + 0.2), (red > 0.4) & (green < 0.25) & (blue < 0.25)
        heights = [np.nonzero(part)[0].mean() for part in (shirt, shoes)]
        assert heights[0] + 0.4 * np.ptp(rows) < heights[1]
    for first, second in ((0, 1), (1, 2), (0, 2)):
        apart = np.abs(pictures[first] - pictures[second]).max(axis=2) > 0.1
        assert apart.mean() > 0.005


@pytest.mark.slow
def test_one_finger_turns_and_two_come_nearer(article: Any) -> None:
    touch_session = article.context.new_cdp_session(article)
    box = article.locator("gsgen-model").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 3

    def drag(*offsets: tuple[tuple[float, float], ...]) -> None:
        """Move fingers through offsets from the middle; each entry has one per finger."""
        for kind, fingers in zip(
            ("touchStart", *["touchMove"] * len(offsets)), offsets, strict=False
        ):
            points = [{"x": x + dx, "y": y + dy, "id": i} for i, (dx, dy) in enumerate(fingers)]
            touch_session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        touch_session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        settled(article)

    before = article.evaluate(
        f"[...{_ELEMENT}._shown.orbit.turn, {_ELEMENT}._shown.orbit.distance]"
    )
    drag(((0, 0),), ((20, 0),), ((60, 0),))
    turned = article.evaluate(
        f"[...{_ELEMENT}._shown.orbit.turn, {_ELEMENT}._shown.orbit.distance]"
    )
    assert np.abs(np.subtract(turned, before))[:9].max() > 0.1
    assert turned[9] == before[9]
    drag(((-20, 0), (20, 0)), ((-30, 0), (30, 0)), ((-60, 0), (60, 0)))
    assert article.evaluate(f"{_ELEMENT}._shown.orbit.distance") < 0.6 * turned[9]


@pytest.mark.slow
def test_five_hundred_frames_leave_nothing_behind(article: Any) -> None:
    """Of a moving camera and a moving person, only encoders, passes and commands are made."""
    result = steady_frames(article, 500, are_executed=False)
    assert result.made == {}
    assert result.heap_growth < 1 << 20


@pytest.mark.slow
def test_reduced_motion_is_respected(article: Any) -> None:
    article.emulate_media(reduced_motion="reduce")
    article.evaluate(f"{_ELEMENT}.report = null")
    article.evaluate(f"{_ELEMENT}.setAttribute('src', 'walk.onnx?again')")
    article.wait_for_function(f"{_ELEMENT}.report")
    assert article.evaluate(f"{_ELEMENT}.paused")
