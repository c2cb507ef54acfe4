"""How a window begins, takes dropped files, and ends."""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.scene_source import sources_of
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer
from gsgen.runtime.viewer.window import accept_dropped_files
from support.models.endless import endless
from support.rendering.viewers import SIZE, Hand


def test_unrecoverable_device_loss_closes_the_window(cloud: SplatData) -> None:
    opened: list[Device] = []

    def open_device() -> Device:
        if opened:
            raise DeviceUnavailable("no graphics adapter")
        opened.append(Device.open())
        return opened[-1]

    hand = Hand(LivePlayback(sources_of(cloud)), SurfaceRenderer(open_device))
    hand.look()
    opened[0].raw.destroy()
    hand.viewer.mode = "alpha"
    with pytest.raises(DeviceUnavailable, match="lost, and cannot be opened again"):
        hand.look()


def test_a_window_closes_while_a_model_computes_for_ever(tmp_path: Path) -> None:
    stage = LivePlayback(sources_of(endless(tmp_path, after=0.5)), time=0.0)
    (source,) = stage.sources
    source.start(None, {"time": 1.0})
    time.sleep(0.2)
    assert not source.ready
    stage.close()  # or this test never ends


def test_view_shows_a_scene_on_any_canvas(cloud: SplatData) -> None:
    from rendercanvas.offscreen import OffscreenRenderCanvas

    from gsgen.runtime import view

    canvas = OffscreenRenderCanvas(size=SIZE)
    assert view(Scene([cloud]), canvas=canvas, size=SIZE) is canvas
    result = np.asarray(canvas.draw())
    assert result.shape == (*SIZE[::-1], 4)
    assert result[..., :3].max() > 60


def test_view_without_a_screen_raises_before_a_window_aborts_the_process() -> None:
    program = (
        "from gsgen.runtime import view\n"
        "from gsgen.runtime.errors import DisplayUnavailable\n"
        "try:\n    view('cloud.ply')\n"
        "except DisplayUnavailable as error:\n    print(error)\n"
    )
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    without_screen = {name: value for name, value in os.environ.items() if name not in names}
    completed = subprocess.run(
        [sys.executable, "-c", program],
        env=without_screen,
        capture_output=True,
        encoding="utf-8",
        timeout=120,
    )
    assert completed.returncode == 0, completed.stderr
    assert "no window can be opened" in completed.stdout
    assert "pip install anywidget" in completed.stdout


def test_files_that_are_dropped_on_a_window_are_opened(
    cloud: SplatData, painter: SurfaceRenderer, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """glfw gives what is dropped to who asked for it; there is no screen here to drop on."""
    glfw = pytest.importorskip("glfw")
    opened_windows: list[Any] = []
    monkeypatch.setattr(glfw, "set_drop_callback", lambda *words: opened_windows.append(words))
    opened: list[Sequence[Path]] = []

    def reopen(paths: Sequence[Path]) -> LivePlayback:
        opened.append(paths)
        return LivePlayback(sources_of(cloud))

    hand = Hand(LivePlayback(sources_of(cloud)), painter, open_files=reopen)
    accept_dropped_files(hand.viewer, SimpleNamespace(_window="window", request_draw=lambda: None))
    ((window, dropped_callback),) = opened_windows
    assert window == "window"
    dropped_callback(window, [str(tmp_path / "a.ply"), str(tmp_path / "b.ply")])
    assert opened == [[tmp_path / "a.ply", tmp_path / "b.ply"]]


def test_unexpected_error_closes_the_window(still: Hand, monkeypatch: pytest.MonkeyPatch) -> None:
    def fall(*_: object, **__: object) -> None:
        raise ZeroDivisionError("odd")

    monkeypatch.setattr(Renderer, "draw", fall)
    with pytest.raises(ZeroDivisionError):
        still.look()
    still.canvas.draw()
    assert still.canvas.get_closed()
