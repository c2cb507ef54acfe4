"""The viewer: events in, a picture on a surface out; which window that is in is not its concern."""

__all__ = ["HELP", "Viewer"]

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE
from gsgen.runtime.errors import DeviceLost, DeviceUnavailable
from gsgen.runtime.media import pictures
from gsgen.runtime.media.pictures import MODES, Mode
from gsgen.runtime.playback.camera_options import Viewpoint
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.viewer.camera_controls import KEYS, Controls
from gsgen.runtime.viewer.live_playback import LivePlayback
from gsgen.runtime.viewer.panels import Slider, paragraph
from gsgen.runtime.viewer.present import Panel, View
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer, ViewRequest
from gsgen.sdk.rewriting.atomic_model_files import atomic_write

HELP: Final = (
    ("left drag", "turn around what is looked at"),
    ("right drag", "look around"),
    ("middle or shift drag", "move sideways"),
    ("wheel", "nearer, farther"),
    ("W A S D, Q E", "fly; Q down, E up; with shift faster"),
    ("double click, F", "look at what is under the pointer, or at everything"),
    ("R", "back to the first camera"),
    ("space", "play, pause"),
    ("arrows, home", "frame by frame, first frame"),
    ("1 2 3 4 5", "colour, depth, median depth, normals, alpha"),
    ("G", "harmonics: as told, 0, 1, 2, 3"),
    ("X", "antialias: as told, classic, mip"),
    ("B", "background: as told, white, grey, black"),
    ("P", "save the picture and its camera"),
    ("I", "numbers"),
    ("H", "this help"),
    ("escape", "close"),
)
"""Keys and what they do, as the help overlay and the guide have them."""

_MODES: Final[dict[str, Mode]] = dict(zip("12345", MODES, strict=True))
_BACKGROUNDS: Final = ((1.0, 1.0, 1.0, 1.0), (0.5, 0.5, 0.5, 1.0), (0.0, 0.0, 0.0, 1.0))
_DEGREES: Final = (None, *range(MAX_DEGREE + 1))
_ANTIALIAS: Final = (None, "classic", "mip")
_LONGEST: Final = 0.25  # seconds of a step: a stall is no jump
_REFRESH: Final = 0.25  # seconds that numbers stand still
_SLOW: Final = 0.12  # seconds that a picture may take while something moves
_COARSEST: Final = 4
_EDGE: Final = 10
_LEFT_BUTTON, _RIGHT_BUTTON, _MIDDLE_BUTTON = 1, 2, 3


@final
class Viewer:
    """Shows a stage to somebody who turns it about.

    Events are dictionaries as rendercanvas has them; keys are its names of keys.

    Args:
        stage: What is shown.
        view: From where it is first seen.
        painter: What draws it; a new one where absent.
        mode: What is first shown of it.
        background: Red, green, blue, alpha.
        folder: Where pictures are saved.
        say: Gets what is to be printed.
        reopen: Opens dropped files; None where none can be dropped.
        clock: Tells seconds.

    Attributes:
        stage: What is shown.
        controls: The camera.
        mode: What is shown of it.
        message: What the user is told; it goes with the next key or click.
        closed: Whether somebody asked to close.

    Raises:
        DeviceUnavailable: There is nothing to draw with.
    """

    def __init__(
        self,
        stage: LivePlayback,
        view: Viewpoint,
        *,
        painter: SurfaceRenderer | None = None,
        mode: Mode = "color",
        background: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        folder: Path = Path(),
        say: Callable[[str], None] = lambda _: None,
        reopen: Callable[[Sequence[Path]], LivePlayback] | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.stage, self.mode, self._view = stage, mode, view
        self._painter = painter or SurfaceRenderer()
        self._backgrounds = [tuple(map(float, background)), *_BACKGROUNDS]
        self._folder, self._say, self._reopen, self._clock = folder, say, reopen, clock
        self.message, self.closed = "", False
        self._held: frozenset[str] = frozenset()
        self._dragging: int | None = None
        self._sliding = self._shift = self._helping = False
        self._telling = True
        self._pointer, self._ratio, self._size = (0.0, 0.0), 1.0, (1, 1)
        self._last, self._told = clock(), -math.inf
        self._times: deque[float] = deque()
        self._numbers: tuple[tuple[str, str], ...] = ()
        self._panels: dict[object, Panel] = {}
        self.controls = self._taken_up()

    def _taken_up(self) -> Controls:
        source = self.stage.sources[0]
        center, reach = self.stage.middle
        home = self._view.camera(source, 0, 0.0)
        return Controls(home, np.array(self._view.up or source.up), center, reach)

    # ----- what is shown

    def draw(self, context: Any) -> bool:
        """Show the present moment on a surface, and say whether another picture will be wanted.

        Args:
            context: A rendercanvas ``WgpuContext``; it is configured here.

        Raises:
            DeviceUnavailable: The device was lost, and there is no other.
        """
        try:
            return self._draw(context)
        except DeviceLost:
            self._recover()
        try:
            return self._draw(context)
        except DeviceLost as error:
            raise DeviceUnavailable(
                "the graphics device was lost, and lost again",
                hint="Show fewer Gaussians or a smaller window; see `gsgen doctor`.",
            ) from error

    def _recover(self) -> None:
        self._painter.recover()
        self.message = "The graphics device was lost. It was opened again."

    def _draw(self, context: Any) -> bool:
        now = self._clock()
        passed, self._last = min(now - self._last, _LONGEST), now
        width, height = context.physical_size
        self._size = (max(1, width), max(1, height))
        flying = self.controls.fly(self._held, passed, self._shift)
        self.stage.advance(passed)
        self._guarded(self.stage.take)
        moving = flying or self.stage.playing or self._dragging is not None
        camera = self.camera(self._coarseness() if moving else 1)
        self.stage.begin(camera)
        self._guarded(self.stage.take)  # what is a file, or quick, is here at once
        view: View | None = None
        try:
            wish = ViewRequest(camera, self.mode, self._background)
            view = self._painter.view(self.stage, wish)
        except DeviceLost:
            raise
        except GsgenError as error:
            self.message, self.stage.playing = str(error), False
        self._tell(now, moving)
        self._painter.show(context, view, self._laid())
        return moving or self.stage.busy

    def _guarded(self, do: Callable[[], None]) -> None:
        """Do something; what is wrong with it is shown, and ends nothing."""
        try:
            do()
        except DeviceLost:
            self._recover()
        except GsgenError as error:
            self.message = str(error)

    def camera(self, coarse: int = 1) -> Camera:
        """Return from where it is seen now.

        Args:
            coarse: Pixels of the surface for each of the image.
        """
        width, height = self._size
        whole = self.controls.camera(width, height)
        if coarse == 1:
            return whole
        return whole.scaled(max(1, width // coarse), max(1, height // coarse))

    def _coarseness(self) -> int:
        """Return how coarse pictures have to be to follow the hand."""
        drawn = self._painter.drawn
        if drawn is None:
            return 1
        whole = self._painter.seconds * self._size[0] / max(1, drawn.row)
        return int(np.clip(math.ceil(whole / _SLOW), 1, _COARSEST))

    @property
    def _background(self) -> tuple[float, ...]:
        return self._backgrounds[0]

    @property
    def slider(self) -> Slider | None:
        """Where the slider is, or None where nothing moves."""
        return Slider(*self._size, self._ratio) if self.stage.frames > 1 else None

    def _laid(self) -> list[Panel]:
        """Return the panels, made anew where what they say has changed."""
        edge, ratio = round(_EDGE * self._ratio), self._ratio
        makers: dict[object, Callable[[], Panel]] = {}
        if self._telling and self._numbers and not self._helping:
            rows = self._numbers
            makers["numbers", rows, ratio] = lambda: Panel(
                paragraph(rows, ratio), (edge, edge)
            )
        if slider := self.slider:
            share, label = self.stage.number / (self.stage.frames - 1), self._label()
            playing = self.stage.playing
            makers["slider", slider, share, label, playing] = lambda: Panel(
                slider.picture(share, label, playing), slider.at
            )
        if self.message:
            lines = tuple(
                (line, "") for line in _wrapped(self.message, self._size[0] / ratio)
            )
            makers["message", lines, self._size, ratio] = lambda: self._centered(lines, 0.3)
        if self._helping:
            makers["help", self._size, ratio] = lambda: self._centered(HELP, 0.5)
        self._panels = {
            key: self._panels.get(key) or make() for key, make in makers.items()
        }
        return list(self._panels.values())

    def _centered(self, rows: Sequence[tuple[str, str]], share: float) -> Panel:
        picture = paragraph(rows, self._ratio)
        left = max(0, (self._size[0] - picture.shape[1]) // 2)
        return Panel(
            picture, (left, max(0, round((self._size[1] - picture.shape[0]) * share)))
        )

    def _label(self) -> str:
        moment = self.stage.moment()
        time_text = "" if moment is None else f"  t {moment:.3g}"
        return f"{self.stage.number + 1} / {self.stage.frames}{time_text}"

    def _tell(self, now: float, moving: bool) -> None:
        """Write the numbers, not more often than they can be read."""
        self._times.append(now)
        while now - self._times[0] > 1:
            self._times.popleft()
        drawn, painter = self._painter.drawn, self._painter
        if drawn is None or (moving and now - self._told < _REFRESH):
            return
        self._told = now
        count = sum(source.data.count for source in self.stage.sources)
        thinking = sum(source.seconds for source in self.stage.sources)
        rows = [
            (f"{self.mode}, {self._size[0]}×{self._size[1]}   H: help", ""),
            ("Gaussians", f"{count:,}, {drawn.visible:,} drawn"),
            ("inference", f"{1000 * thinking:.1f} ms"),
            ("drawing", f"{1000 * painter.seconds:.1f} ms"),
        ]
        if not any(source.inputs for source in self.stage.sources):
            del rows[2]  # nothing is computed
        if moving:
            rows.append(("pictures", f"{len(self._times)} a second"))
        if self.stage.sh_degree is not None:
            rows.append(("harmonics", f"up to degree {self.stage.sh_degree}"))
        if self.stage.antialias is not None:
            rows.append(("antialias", self.stage.antialias))
        self._numbers = tuple(rows)

    # ----- what is done

    def handle(self, event: Mapping[str, Any]) -> None:
        """Take an event; those that mean nothing here are left alone."""
        act = {
            "key_down": self._key_down,
            "key_up": self._key_up,
            "pointer_down": self._pointer_down,
            "pointer_move": self._pointer_move,
            "pointer_up": self._pointer_up,
            "double_click": self._double_click,
            "wheel": self._wheel,
            "resize": self._resized,
        }.get(event["event_type"])
        if act is not None:
            act(event)

    def drop(self, paths: Sequence[Path]) -> None:
        """Show other files in place of these; where they cannot be read, a message says so."""
        if self._reopen is None:
            return
        try:
            stage = self._reopen(paths)
        except GsgenError as error:
            self.message = str(error)
            return
        self.stage.close()
        self.stage, self.message = stage, ""
        self._view = replace(self._view, orbit=(30.0, 20.0, None), look_at=None, cameras=())
        self.controls = self._taken_up()

    def _resized(self, event: Mapping[str, Any]) -> None:
        self._ratio = float(event.get("pixel_ratio") or 1.0)

    def _key_down(self, event: Mapping[str, Any]) -> None:
        key = str(event["key"])
        key = key.lower() if len(key) == 1 else key
        self._shift = "Shift" in event.get("modifiers", ()) or key == "Shift"
        helping, self.message = self._helping, ""
        self._told = -math.inf
        if "Control" in event.get("modifiers", ()):
            return
        if key in KEYS:
            self._held |= {key}
        elif key in _MODES:
            self.mode = _MODES[key]
        elif key == "Escape":
            self._helping, self.closed = False, not helping
        elif key in self._acts:
            self._acts[key](self)

    def _key_up(self, event: Mapping[str, Any]) -> None:
        key = str(event["key"])
        self._held -= {key.lower() if len(key) == 1 else key}
        self._shift = self._shift and key != "Shift"

    def _pointer_down(self, event: Mapping[str, Any]) -> None:
        self._pointer, self.message = (event["x"], event["y"]), ""
        x, y = self._on_surface()
        slider = self.slider
        if slider and event["button"] == _LEFT_BUTTON and slider.holds(x, y):
            if slider.on_button(x):
                self._play()
            else:
                self._sliding = True
                self._slide(x)
            return
        self._dragging = int(event["button"])
        self._shift = "Shift" in event.get("modifiers", ())

    def _pointer_move(self, event: Mapping[str, Any]) -> None:
        (x, y), self._pointer = self._pointer, (event["x"], event["y"])
        right, down = self._pointer[0] - x, self._pointer[1] - y
        if self._sliding:
            self._slide(self._on_surface()[0])
        elif self._dragging == _MIDDLE_BUTTON or (
            self._dragging == _LEFT_BUTTON and self._shift
        ):
            right, down = right * self._ratio, down * self._ratio
            self.controls.pan(right, down, *self._size)
        elif self._dragging == _LEFT_BUTTON:
            self.controls.orbit(right, down)
        elif self._dragging == _RIGHT_BUTTON:
            self.controls.look(right, down)

    def _pointer_up(self, event: Mapping[str, Any]) -> None:
        self._dragging, self._sliding = None, False

    def _double_click(self, event: Mapping[str, Any]) -> None:
        self._pointer = (event["x"], event["y"])
        x, y = self._on_surface()
        if self.slider is None or not self.slider.holds(x, y):
            self._focus()

    def _wheel(self, event: Mapping[str, Any]) -> None:
        self.controls.wheel(float(event["dy"]))

    def _on_surface(self) -> tuple[float, float]:
        return self._pointer[0] * self._ratio, self._pointer[1] * self._ratio

    def _slide(self, x: float) -> None:
        assert self.slider is not None
        self.stage.playing = False
        self.stage.seek(round(self.slider.share(x) * (self.stage.frames - 1)))

    def _play(self) -> None:
        self.stage.playing = self.stage.frames > 1 and not self.stage.playing
        if self.stage.frames == 1:
            self.message = (
                "Nothing moves here: no model has a time, and no values were given."
            )

    def _step(self, by: int) -> None:
        self.stage.playing = False
        self.stage.seek(self.stage.number + by)

    def _start_over(self) -> None:
        self.stage.seek(0)

    def _focus(self) -> None:
        self._guarded(self._look_at_pointer)

    def _look_at_pointer(self) -> None:
        camera = self.camera()
        depth = self._painter.frame(self.stage, ViewRequest(camera, "depth", (0, 0, 0, 0)))
        assert depth.depth is not None
        assert depth.median_depth is not None
        x, y = map(int, self._on_surface())
        if not (0 <= x < camera.width and 0 <= y < camera.height):
            self.controls.frame()
            return
        far = min(float(depth.median_depth[y, x]), float(depth.depth[y, x]))
        if math.isfinite(far):
            self.controls.focus(_point(camera, x + 0.5, y + 0.5, far))
        else:
            self.controls.frame()

    def _save(self) -> None:
        self._guarded(self._saved)

    def _saved(self) -> None:
        """Save what is seen, at its finest, and the camera beside it."""
        camera = self.camera()
        self.stage.settle(camera)
        frame = self._painter.frame(
            self.stage, ViewRequest(camera, self.mode, self._background)
        )
        depths = self.stage.depths(camera)
        path = _unused(self._folder)
        pictures.save_picture(path, pictures.picture_of(frame, self.mode, depths))
        file = path.with_suffix(".json")
        with atomic_write(file) as draft:
            draft.write_text(camera.to_json() + "\n", "utf-8")
        self._say(camera.to_json())
        self.message = f"Saved {path} and its camera: --camera {file}"
        self._say(f"{path}: the picture; --camera {file} is its camera")

    def _next_degree(self) -> None:
        self.stage.sh_degree = _after(_DEGREES, self.stage.sh_degree)

    def _next_antialias(self) -> None:
        self.stage.antialias = _after(_ANTIALIAS, self.stage.antialias)

    def _next_background(self) -> None:
        self._backgrounds = [*self._backgrounds[1:], self._backgrounds[0]]

    def _toggle_help(self) -> None:
        self._helping = not self._helping

    def _toggle_numbers(self) -> None:
        self._telling = not self._telling

    _acts: Final[dict[str, Callable[["Viewer"], None]]] = {
        " ": _play,
        "ArrowRight": lambda self: self._step(1),
        "ArrowLeft": lambda self: self._step(-1),
        "Home": _start_over,
        "f": _focus,
        "r": lambda self: self.controls.reset(),
        "g": _next_degree,
        "x": _next_antialias,
        "b": _next_background,
        "p": _save,
        "i": _toggle_numbers,
        "h": _toggle_help,
    }


def _after(choices: Sequence[Any], present: Any) -> Any:
    """Return the choice after the present one; after the last comes the first."""
    return choices[(choices.index(present) + 1) % len(choices)]


def _point(camera: Camera, x: float, y: float, far: float) -> Float[np.ndarray, "3"]:
    """Return what is at a pixel at a depth, in the world."""
    across, down = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    local = np.array([across, down, 1.0]) * far
    if camera.kind == "orthographic":
        local = np.array([across, down, far])
    elif camera.kind == "panorama":
        level = math.cos(down)
        local = far * np.array(
            [math.sin(across) * level, math.sin(down), math.cos(across) * level]
        )
    return np.asarray(camera.eye + camera.view[:3, :3].T @ local)


def _unused(folder: Path) -> Path:
    """Return the first name of a picture that no file has."""
    number = 1
    while any(
        (folder / f"view_{number:03}").with_suffix(s).exists() for s in (".png", ".json")
    ):
        number += 1
    return folder / f"view_{number:03}.png"


def _wrapped(text: str, width: float) -> list[str]:
    import textwrap

    room = max(20, int(width / 8.5))
    return [
        part for line in text.splitlines() for part in textwrap.wrap(line.strip(), room)
    ]
