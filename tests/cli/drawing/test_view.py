"""`gsgen view`, up to where a window would open: that takes a screen."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from gsgen.cli.commands.drawing.view import view
from gsgen.conformance.fixtures import find
from gsgen.contract.errors import GsgenError
from gsgen.runtime.viewer import surface_renderer, window
from gsgen.runtime.viewer.overlay import HELP_LINES
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer
from gsgen.runtime.viewer.viewer import Viewer
from gsgen.sdk.binding import RunFailed
from support.commands import gsgen
from support.models.endless import endless
from support.models.hostile import HOSTILE

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def drift(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return find("drift").write(tmp_path_factory.mktemp("drift"))


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Viewer, str, tuple[int, int]]]:
    """What windows would have been opened with."""
    result: list[tuple[Viewer, str, tuple[int, int]]] = []
    monkeypatch.setattr(window, "require_display", lambda: None)
    monkeypatch.setattr(window, "open_window", lambda *words, after_draw: result.append(words))
    return result


def run_view(*words: str) -> Any:
    app = typer.Typer()
    app.command()(view)
    return CliRunner().invoke(app, list(words))


def test_view_without_a_screen_suggests_render(
    drift: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    finished = gsgen("view", str(drift))
    assert finished.code == 2
    assert "no window can be opened" in finished.err
    assert f"gsgen render {drift} -o view.png" in finished.err
    assert "Traceback" not in finished.err


def test_options_reach_the_viewer(
    drift: Path,
    tmp_path: Path,
    opened: list[tuple[Viewer, str, tuple[int, int]]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    painted: dict[str, object] = {}
    monkeypatch.setattr(
        surface_renderer,
        "SurfaceRenderer",
        lambda **words: painted.update(words) or SurfaceRenderer(),
    )
    finished = run_view(
        str(drift), "--width", "300", "--height", "200", "--mode", "depth",
        "--frames", "7", "--fps", "5", "--camera", "look-at:0,0,-4,0,0,0",
        "--pictures", str(tmp_path), "--sh-degree", "1", "--rasteriser", "quads", "--compact",
    )  # fmt: skip
    assert finished.exit_code == 0, finished.output
    (viewer, title, size) = opened[0]
    assert (title, size) == ("drift.onnx - gsgen", (300, 200))
    assert (viewer.mode, viewer.playback.frames, viewer.playback.fps) == ("depth", 7, 5)
    assert (viewer.playback.playing, viewer.playback.sh_degree) == (True, 1)
    np.testing.assert_allclose(viewer.controls.eye, [0, 0, -4], atol=1e-9)
    assert painted == {"rasteriser": "quads", "compact": True}


def test_fixed_time_stays_constant(
    drift: Path, opened: list[tuple[Viewer, str, tuple[int, int]]]
) -> None:
    assert run_view(str(drift), "--time", "0.5").exit_code == 0
    assert opened[0][0].playback.frames == 1
    assert not opened[0][0].playback.playing


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("nothing.ply",), 4, "nothing.ply"),
        (("DRIFT", "--camera", "upside-down"), 2, "--camera"),
        (("DRIFT", "--input", "wind=3"), 2, "wind"),
        (("DRIFT", "--background", "plaid"), 2, "--background"),
        (("DRIFT", "--frames", "1"), 2, "--frames"),
    ],
)
def test_invalid_view_options_are_named(
    drift: Path,
    opened: list[tuple[Viewer, str, tuple[int, int]]],
    words: tuple[str, ...],
    code: int,
    message: str,
) -> None:
    finished = run_view(*(str(drift) if word == "DRIFT" else word for word in words))
    if isinstance(finished.exception, GsgenError):
        assert (code, message in str(finished.exception)) == (2, True)
    else:
        assert finished.exit_code == code, finished.output
        assert message in finished.output + finished.stderr
    assert not opened


def test_the_guide_has_the_keys_that_the_window_shows() -> None:
    guide = (DOCS / "guides/view-a-scene.md").read_text("utf-8")
    for keys, key_action in HELP_LINES:
        assert f"| {keys} | {key_action} |" in guide


def test_exported_page_is_refused_as_a_scene(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("<title>A page</title>", "utf-8")
    finished = run_view(str(tmp_path / "page.html"), "--web")
    assert isinstance(finished.exception, GsgenError)
    assert "page.html: is a page, expected a scene" in str(finished.exception)
    assert "gsgen export html SCENE -o page.html" in str(finished.exception.hint)


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.usefixtures("opened")
def test_a_hostile_model_ends_before_a_window_opens(tmp_path: Path, name: str) -> None:
    path = HOSTILE[name](tmp_path)
    finished = run_view(str(path), "--timeout", "3")
    assert isinstance(finished.exception, RunFailed)
    assert "limit (--" in str(finished.exception)
    assert "\n" not in str(finished.exception)


def test_a_frame_that_never_ends_stops_the_viewer_at_the_time_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The window shows the first frame; the one at the end of the time range never ends."""

    def play(viewer: Viewer, *_: object, **__: object) -> None:
        viewer.playback.seek(viewer.playback.frames - 1)
        viewer.playback.settle(viewer.controls.camera(32, 32))

    monkeypatch.setattr(window, "require_display", lambda: None)
    monkeypatch.setattr(window, "open_window", play)
    finished = run_view(str(endless(tmp_path, after=0.5)), "--timeout", "2")
    assert isinstance(finished.exception, RunFailed)
    assert "a frame takes more than 2 s, the time limit (--timeout)" in str(finished.exception)
