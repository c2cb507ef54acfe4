"""The interactive viewer: handles input events, and draws frames on a surface."""

__all__ = ["Event", "Viewer"]

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, TypeVar, final

import numpy as np

from gsgen.contract.errors import GsgenError
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE
from gsgen.runtime.errors import DeviceLost, DeviceUnavailable
from gsgen.runtime.media import pictures
from gsgen.runtime.media.pictures import PICTURE_MODES, Mode
from gsgen.runtime.playback.camera_options import Viewpoint
from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.viewer.camera_controls import CAMERA_KEYS, Controls, unproject
from gsgen.runtime.viewer.overlay import Overlay, SliderState
from gsgen.runtime.viewer.panels import Slider
from gsgen.runtime.viewer.present import View
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer, ViewRequest

if TYPE_CHECKING:
    from rendercanvas.contexts import WgpuContext

Choice = TypeVar("Choice")
Event: TypeAlias = Mapping[str, Any]
"""Fields of an event by name: of an input event of rendercanvas, or one for a program."""

_MODE_BY_KEY: Final[dict[str, Mode]] = dict(zip("12345", PICTURE_MODES, strict=True))
_BACKGROUND_CHOICES: Final = ((1.0, 1.0, 1.0, 1.0), (0.5, 0.5, 0.5, 1.0), (0.0, 0.0, 0.0, 1.0))
_SH_DEGREES: Final = (None, *range(MAX_DEGREE + 1))
_ANTIALIAS_CHOICES: Final[tuple[Literal["classic", "mip"] | None, ...]] = (None, "classic", "mip")
_MAX_STEP: Final = 0.25  # seconds; time does not jump after a stall
_MAX_SECONDS: Final = 0.12  # that drawing may take while something moves
_MAX_COARSENESS: Final = 4
_LEFT_BUTTON, _RIGHT_BUTTON, _MIDDLE_BUTTON = 1, 2, 3


@final
class Viewer:
    """An interactive view of a playback: camera, time slider, drawing modes and overlay.

    Events are dictionaries of rendercanvas; keys have its names.

    Args:
        playback: The playback that is shown.
        view: The first camera.
        renderer: Draws on the surface; a new one by default.
        mode: The first output that is shown.
        background: Red, green, blue and alpha, from 0 to 1.
        folder: Folder of saved pictures.
        print_line: Called with each line for the console.
        on_event: Called with each event for a program, instead of ``print_line``: JSON values by
            name, of which ``event`` is the kind.
        open_files: Opens dropped files; None if files cannot be dropped.
        clock: Returns seconds.

    Attributes:
        playback: The playback that is shown.
        controls: The camera.
        mode: The output that is shown.
        message: A message for the user, until the next key or click.
        closed: Whether the user has asked to close the window.
    """

    def __init__(
        self,
        playback: LivePlayback,
        view: Viewpoint,
        *,
        renderer: SurfaceRenderer | None = None,
        mode: Mode = "color",
        background: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        folder: Path = Path(),
        print_line: Callable[[str], None] = lambda _: None,
        on_event: Callable[[Event], None] | None = None,
        open_files: Callable[[Sequence[Path]], LivePlayback] | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.playback, self.mode, self._view = playback, mode, view
        self._renderer = renderer or SurfaceRenderer()
        self._backgrounds = [tuple(map(float, background)), *_BACKGROUND_CHOICES]
        self._folder, self._print_line, self._on_event = folder, print_line, on_event
        self._open_files, self._clock = open_files, clock
        self.message, self.closed = "", False
        self._overlay = Overlay()
        self._pressed_keys: frozenset[str] = frozenset()
        self._drag_button: int | None = None
        self._is_moving_slider = self._is_shift_held = False
        self._pointer, self._pixel_ratio, self._size = (0.0, 0.0), 1.0, (1, 1)
        self._last_draw_time = clock()
        self.controls = self._make_controls()

    def _make_controls(self) -> Controls:
        source = self.playback.sources[0]
        center, reach = source.extent()
        initial_camera = self._view.camera(source, 0, 0.0)
        return Controls(initial_camera, np.array(self._view.up or source.up), center, reach)

    # ----- drawing

    def draw(self, context: "WgpuContext") -> bool:
        """Draw the current frame on a surface, and return whether another one will be needed."""
        try:
            return self._draw(context)
        except DeviceLost:
            self._recover_device()
        try:
            return self._draw(context)
        except DeviceLost as error:
            raise DeviceUnavailable(
                "the graphics device was lost twice while drawing one frame",
                hint="Show fewer Gaussians or a smaller window; see `gsgen doctor`.",
            ) from error

    def _recover_device(self) -> None:
        self._renderer.recover()
        self.message = "The graphics device was lost. It was opened again."

    def _draw(self, context: "WgpuContext") -> bool:
        # Step 1: let time pass, for the flight of the camera and for the playback.
        now = self._clock()
        elapsed_seconds, self._last_draw_time = min(now - self._last_draw_time, _MAX_STEP), now
        width, height = context.physical_size
        self._size = (max(1, width), max(1, height))
        is_flying = self.controls.fly(
            self._pressed_keys, elapsed_seconds, is_fast=self._is_shift_held
        )
        self.playback.advance(elapsed_seconds)
        # Step 2: take the frame that was computed, and begin the current one. A file, or a quick
        # model, is ready at once.
        self._show_errors(self.playback.take)
        is_moving = is_flying or self.playback.playing or self._drag_button is not None
        camera = self.camera(self._downscale() if is_moving else 1)
        self.playback.begin(camera)
        self._show_errors(self.playback.take)
        # Step 3: draw it, with the panels over it.
        view: View | None = None
        try:
            view = self._renderer.view(self.playback, self._request(camera))
        except DeviceLost:
            raise
        except GsgenError as error:
            self.message, self.playback.playing = str(error), False
        self._overlay.statistics.update(
            now,
            self.playback,
            self._renderer,
            title=f"{self.mode}, {self._size[0]}×{self._size[1]}   H: help",
            is_moving=is_moving,
        )
        slider = self.slider
        panels = self._overlay.panels(
            self._size,
            self._pixel_ratio,
            slider=(slider, self._slider_state()) if slider else None,
            message=self.message,
        )
        self._renderer.show(context, view, panels)
        return is_moving or self.playback.busy or bool(self._renderer.renderer.late_counts)

    def _show_errors(self, action: Callable[[], None]) -> None:
        """Run an action of the viewer, and show its error as a message."""
        try:
            action()
        except DeviceLost:
            self._recover_device()
        except GsgenError as error:
            self.message = str(error)

    def _request(self, camera: Camera) -> ViewRequest:
        return ViewRequest(camera, self.mode, self._backgrounds[0])

    def camera(self, downscale: int = 1) -> Camera:
        """Return the viewer's camera; an image pixel covers ``downscale``² surface pixels."""
        width, height = self._size
        camera = self.controls.camera(width, height)
        if downscale == 1:
            return camera
        small_camera = camera.scaled(max(1, width // downscale), max(1, height // downscale))
        # Splats keep their size on the surface: the filter of its pixels, not of the image's.
        return replace(small_camera, dilation=camera.dilation / downscale**2)

    def _downscale(self) -> int:
        """Return the factor by which image size is reduced, so that a frame is drawn in time."""
        drawn = self._renderer.drawn
        if drawn is None:
            return 1
        full_size_seconds = self._renderer.seconds * self._size[0] / max(1, drawn.row)
        return int(np.clip(math.ceil(full_size_seconds / _MAX_SECONDS), 1, _MAX_COARSENESS))

    @property
    def slider(self) -> Slider | None:
        """The state of the time slider, or None if nothing in the scene moves."""
        return Slider(*self._size, self._pixel_ratio) if self.playback.frames > 1 else None

    def _slider_state(self) -> SliderState:
        number, frames = self.playback.number, self.playback.frames
        moment = self.playback.moment()
        time_text = "" if moment is None else f"  t {moment:.3g}"
        return SliderState(
            fraction=number / (frames - 1),
            label=f"{number + 1} / {frames}{time_text}",
            playing=self.playback.playing,
        )

    # ----- events

    def handle(self, event: Event) -> None:
        """Handle an input event of rendercanvas; other event types have no effect."""
        handler = {
            "key_down": self._key_down,
            "key_up": self._key_up,
            "pointer_down": self._pointer_down,
            "pointer_move": self._pointer_move,
            "pointer_up": self._pointer_up,
            "double_click": self._double_click,
            "wheel": self._wheel,
            "resize": self._on_resize,
        }.get(event["event_type"])
        if handler is not None:
            handler(event)

    def drop(self, paths: Sequence[Path]) -> None:
        """Show files dropped on the window instead of the scene; if unreadable, show a message."""
        if self._open_files is None:
            return
        try:
            playback = self._open_files(paths)
        except GsgenError as error:
            self.message = str(error)
            return
        if self._on_event is not None:
            self._on_event({"event": "opened", "scenes": list(map(str, paths))})
        self.playback.close()
        self.playback, self.message = playback, ""
        self._view = replace(self._view, orbit=None, look_at=None, cameras=())
        self.controls = self._make_controls()

    def _on_resize(self, event: Event) -> None:
        self._pixel_ratio = float(event.get("pixel_ratio") or 1.0)

    def _key_down(self, event: Event) -> None:
        key = str(event["key"])
        key = key.lower() if len(key) == 1 else key
        self._is_shift_held = "Shift" in event.get("modifiers", ()) or key == "Shift"
        self.message = ""
        self._overlay.statistics.refresh()
        if "Control" in event.get("modifiers", ()):
            return
        if key in CAMERA_KEYS:
            self._pressed_keys |= {key}
        elif key in _MODE_BY_KEY:
            self.mode = _MODE_BY_KEY[key]
        elif key == "Escape":  # it closes the help first
            self.closed, self._overlay.shows_help = not self._overlay.shows_help, False
        elif key in self._key_actions:
            self._key_actions[key](self)

    def _key_up(self, event: Event) -> None:
        key = str(event["key"])
        self._pressed_keys -= {key.lower() if len(key) == 1 else key}
        self._is_shift_held = self._is_shift_held and key != "Shift"

    def _pointer_down(self, event: Event) -> None:
        self._pointer, self.message = (event["x"], event["y"]), ""
        x, y = self._surface_position()
        slider = self.slider
        if slider and event["button"] == _LEFT_BUTTON and slider.contains(x, y):
            if slider.is_on_button(x):
                self._toggle_playing()
            else:
                self._is_moving_slider = True
                self._move_slider(x)
            return
        self._drag_button = int(event["button"])
        self._is_shift_held = "Shift" in event.get("modifiers", ())

    def _pointer_move(self, event: Event) -> None:
        (x, y), self._pointer = self._pointer, (event["x"], event["y"])
        right, down = self._pointer[0] - x, self._pointer[1] - y
        is_shift_drag = self._drag_button == _LEFT_BUTTON and self._is_shift_held
        if self._is_moving_slider:
            self._move_slider(self._surface_position()[0])
        elif self._drag_button == _MIDDLE_BUTTON or is_shift_drag:
            self.controls.pan(right * self._pixel_ratio, down * self._pixel_ratio, *self._size)
        elif self._drag_button == _LEFT_BUTTON:
            self.controls.orbit(right, down)
        elif self._drag_button == _RIGHT_BUTTON:
            self.controls.look(right, down)

    def _pointer_up(self, event: Event) -> None:
        self._drag_button, self._is_moving_slider = None, False

    def _double_click(self, event: Event) -> None:
        self._pointer = (event["x"], event["y"])
        x, y = self._surface_position()
        if self.slider is None or not self.slider.contains(x, y):
            self._show_errors(self._look_at_pointer)

    def _wheel(self, event: Event) -> None:
        self.controls.wheel(float(event["dy"]))

    def _surface_position(self) -> tuple[float, float]:
        """Return the position of the pointer in pixels of the surface."""
        return self._pointer[0] * self._pixel_ratio, self._pointer[1] * self._pixel_ratio

    # ----- actions of keys and of the pointer

    def _move_slider(self, x: float) -> None:
        assert self.slider is not None
        self.playback.playing = False
        self.playback.seek(round(self.slider.fraction(x) * (self.playback.frames - 1)))

    def _toggle_playing(self) -> None:
        self.playback.playing = self.playback.frames > 1 and not self.playback.playing
        if self.playback.frames == 1:
            self.message = "Nothing moves: no model has a time, and no input varies."

    def _step_frames(self, frames: int) -> None:
        self.playback.playing = False
        self.playback.seek(self.playback.number + frames)

    def _look_at_pointer(self) -> None:
        camera = self.camera()
        request = ViewRequest(camera, "depth", (0, 0, 0, 0))
        frame = self._renderer.frame(self.playback, request)
        assert frame.depth is not None
        assert frame.median_depth is not None
        x, y = map(int, self._surface_position())
        is_inside = 0 <= x < camera.width and 0 <= y < camera.height
        depth = math.inf
        if is_inside:
            depth = min(float(frame.median_depth[y, x]), float(frame.depth[y, x]))
        if math.isfinite(depth):
            self.controls.focus(unproject(camera, x + 0.5, y + 0.5, depth))
        else:
            self.controls.frame()

    def _save_picture(self) -> None:
        """Save the picture at full resolution, and the camera under the same name."""
        camera = self.camera()
        self.playback.settle(camera)
        frame = self._renderer.frame(self.playback, self._request(camera))
        depths = self.playback.depths(camera)
        path = _unused_screenshot_path(self._folder)
        pictures.save_picture(path, pictures.picture_of(frame, self.mode, depths))
        file = path.with_suffix(".json")
        with atomic_write(file) as draft:
            draft.write_text(camera.to_json() + "\n", "utf-8")
        self.message = f"Saved {path} and its camera: --camera {file}"
        if self._on_event is not None:
            self._on_event({"event": "picture", "path": str(path), "camera": str(file)})
            return
        self._print_line(camera.to_json())
        self._print_line(f"{path}: the picture; --camera {file} is its camera")

    def _next_degree(self) -> None:
        self.playback.sh_degree = _next_choice(_SH_DEGREES, self.playback.sh_degree)

    def _next_antialias(self) -> None:
        self.playback.antialias = _next_choice(_ANTIALIAS_CHOICES, self.playback.antialias)

    def _next_background(self) -> None:
        self._backgrounds = [*self._backgrounds[1:], self._backgrounds[0]]

    def _toggle_help(self) -> None:
        self._overlay.shows_help = not self._overlay.shows_help

    def _toggle_statistics(self) -> None:
        self._overlay.shows_statistics = not self._overlay.shows_statistics

    _key_actions: Final[dict[str, Callable[["Viewer"], None]]] = {
        " ": _toggle_playing,
        "ArrowRight": lambda self: self._step_frames(1),
        "ArrowLeft": lambda self: self._step_frames(-1),
        "Home": lambda self: self.playback.seek(0),
        "f": lambda self: self._show_errors(self._look_at_pointer),
        "r": lambda self: self.controls.reset(),
        "g": _next_degree,
        "x": _next_antialias,
        "b": _next_background,
        "p": lambda self: self._show_errors(self._save_picture),
        "i": _toggle_statistics,
        "h": _toggle_help,
    }


def _next_choice(choices: Sequence[Choice], current_choice: Choice) -> Choice:
    """Return the value that follows the current one in a cyclic list of choices."""
    return choices[(choices.index(current_choice) + 1) % len(choices)]


def _unused_screenshot_path(folder: Path) -> Path:
    """Return the first of ``view_001.png``, … whose picture and camera file do not exist yet."""
    number = 1
    while any(
        (folder / f"view_{number:03}").with_suffix(suffix).exists() for suffix in (".png", ".json")
    ):
        number += 1
    return folder / f"view_{number:03}.png"
