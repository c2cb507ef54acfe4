"""Viewers on offscreen canvases: what a hand does goes in, and pixels come out."""

from typing import Any

import numpy as np
from rendercanvas.offscreen import OffscreenRenderCanvas

from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer
from gsgen.runtime.viewer.viewer import Viewer
from gsgen.runtime.viewer.window import attach

SIZE = (160, 120)


class Hand:
    """A viewer, and who uses it.

    Attributes:
        viewer: It.
        now: Seconds; time passes as tests say.
        said: What was printed.
    """

    def __init__(self, playback: LivePlayback, renderer: SurfaceRenderer, **options: Any) -> None:
        self.now, self.said = 0.0, list[str]()
        view = options.pop("view", None) or viewpoint("look-at:0,0,-4,0,0,0", *SIZE)
        self.viewer = Viewer(
            playback,
            view,
            renderer=renderer,
            clock=lambda: self.now,
            print_line=self.said.append,
            **options,
        )
        self.canvas = OffscreenRenderCanvas(size=SIZE)
        self.failure = attach(self.viewer, self.canvas)

    def key(self, name: str, *modifiers: str) -> None:
        self.press(name, *modifiers)
        self.send("key_up", key=name, modifiers=modifiers)

    def press(self, name: str, *modifiers: str) -> None:
        self.send("key_down", key=name, modifiers=modifiers)

    def drag(
        self, start: tuple[float, float], end: tuple[float, float], button: int = 1, *held: str
    ) -> None:
        for kind, point in (("down", start), ("move", end), ("up", end)):
            self.send(f"pointer_{kind}", x=point[0], y=point[1], button=button, modifiers=held)

    def send(self, kind: str, **words: Any) -> None:
        self.canvas.submit_event({"event_type": kind, **words})
        self.canvas._events.flush()  # the offscreen canvas has no loop that would

    def look(self, seconds: float = 0.0) -> np.ndarray:
        """Return the picture after so many seconds."""
        self.now += seconds
        result = np.asarray(self.canvas.draw())
        if (error := self.failure()) is not None:
            raise error
        return result.astype(int)

    def settled(self, seconds: float = 0.0) -> np.ndarray:
        """Return the picture once what was begun is there."""
        self.look(seconds)
        self.viewer.playback.take(wait=True)
        return self.look()

    def bare(self) -> np.ndarray:
        """Return the picture without numbers over it."""
        self.key("i")
        result = self.settled()
        self.key("i")
        return result


def round_cloud() -> SplatData:
    """Return 300 small Gaussians with harmonics."""
    rng = np.random.default_rng(3)
    rows = np.zeros((300, 10), np.float32)
    rows[:, :3] = rng.normal(size=(300, 3)) * 0.5
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.01
    return SplatData(rows, rng.uniform(size=(300, 27)).astype(np.float32) - 0.3, "sh")
