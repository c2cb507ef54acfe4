"""The viewer's panels over the picture: statistics, time slider, messages and help."""

__all__ = ["HELP_LINES", "Overlay", "SliderState", "Statistics"]

import math
import textwrap
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, final

from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.renderer.late_counts import MAX_FRAMES_IN_FLIGHT
from gsgen.runtime.viewer.panels import Slider, paragraph
from gsgen.runtime.viewer.present import Panel
from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer

HELP_LINES: Final = (
    ("left drag", "orbit around the point in view"),
    ("right drag", "look around"),
    ("middle or shift drag", "move sideways"),
    ("wheel", "nearer, farther"),
    ("W A S D, Q E", "fly; Q down, E up; with shift faster"),
    ("double click, F", "look at the point under the pointer, or at everything"),
    ("R", "back to the first camera"),
    ("space", "play, pause"),
    ("arrows, home", "frame by frame, first frame"),
    ("1 2 3 4 5", "colour, depth, median depth, normals, alpha"),
    ("G", "harmonics: scene default, 0, 1, 2, 3"),
    ("X", "antialias: scene default, classic, mip"),
    ("B", "background: scene default, white, grey, black"),
    ("P", "save the picture and its camera"),
    ("I", "numbers"),
    ("H", "this help"),
    ("escape", "close"),
)
"""Keys and mouse actions with their effects, shown by the help panel and the guide."""

_REFRESH_SECONDS: Final = (
    0.25  # seconds between two updates of the statistics while something moves
)
_EDGE_MARGIN: Final = 10  # pixels between a panel and the edge of the window
_CHARACTER_WIDTH: Final = 8.5  # pixels of a character, on average


@final
class Statistics:
    """The viewer's statistics of the last frames, updated slowly enough to be read."""

    def __init__(self) -> None:
        self.rows: tuple[tuple[str, str], ...] = ()
        self._last_update = -math.inf
        self._frame_times: deque[float] = deque()

    def refresh(self) -> None:
        """Make the next :meth:`update` refresh the statistics without its usual delay."""
        self._last_update = -math.inf

    def update(
        self,
        now: float,
        playback: LivePlayback,
        renderer: SurfaceRenderer,
        *,
        title: str,
        is_moving: bool,
    ) -> None:
        """Count a drawn frame, and update the displayed statistics when an update is due."""
        self._frame_times.append(now)
        while now - self._frame_times[0] > 1:
            self._frame_times.popleft()
        drawn_image = renderer.drawn
        if drawn_image is None or (is_moving and now - self._last_update < _REFRESH_SECONDS):
            return
        self._last_update = now
        count = sum(source.count for source in playback.sources)
        rows = [(title, ""), ("Gaussians", f"{count:,}, {drawn_image.visible:,} drawn")]
        if any(source.inputs for source in playback.sources):
            seconds = sum(source.seconds for source in playback.sources)
            rows.append(("inference", f"{1000 * seconds:.1f} ms"))
        rows.append(("drawing", f"{1000 * renderer.seconds:.1f} ms"))
        if late_counts := renderer.renderer.late_counts:
            text = f"{MAX_FRAMES_IN_FLIGHT} frames late, waited {1000 * late_counts.wait_seconds:.1f} ms"
            rows.append(("counts", text))
        if growths := renderer.renderer.growths:
            rows.append(("buffers", f"grew {growths}×"))
        if is_moving:
            rows.append(("pictures", f"{len(self._frame_times)} a second"))
        for source in playback.sources:
            rows += source.statistics
        if playback.sh_degree is not None:
            rows.append(("harmonics", f"up to degree {playback.sh_degree}"))
        if playback.antialias is not None:
            rows.append(("antialias", playback.antialias))
        self.rows = tuple(rows)


@final
@dataclass(frozen=True, slots=True)
class SliderState:
    """What the time slider shows: knob position in [0, 1], label and play state."""

    fraction: float
    label: str
    playing: bool


@final
class Overlay:
    """The viewer's panels, each of which is drawn again only when its content changes."""

    def __init__(self) -> None:
        self.statistics = Statistics()
        self.shows_help, self.shows_statistics = False, True
        self._panels: dict[object, Panel] = {}

    def panels(
        self,
        size: tuple[int, int],
        ratio: float,
        *,
        slider: tuple[Slider, SliderState] | None,
        message: str,
    ) -> list[Panel]:
        """Return the panels (text and controls) to draw over the picture of the current frame.

        Args:
            size: Width and height of the surface, in pixels.
            ratio: Pixels of the surface per logical pixel.
            slider: The time slider and its content, or None.
            message: Text in the middle of the surface; may be empty.
        """
        builders: dict[object, Callable[[], Panel]] = {}
        rows = self.statistics.rows
        if self.shows_statistics and rows and not self.shows_help:
            margin_pixels = round(_EDGE_MARGIN * ratio)
            builders["statistics", rows, ratio] = lambda: Panel(
                paragraph(rows, ratio), (margin_pixels, margin_pixels)
            )
        if slider is not None:
            slider_bar, state = slider
            builders["slider", slider_bar, state] = lambda: Panel(
                slider_bar.picture(state.fraction, state.label, playing=state.playing),
                slider_bar.corner,
            )
        if message:
            lines = tuple((line, "") for line in _wrap_text(message, size[0] / ratio))
            builders["message", lines, size, ratio] = lambda: _centered_panel(
                lines, size, ratio, 0.3
            )
        if self.shows_help:
            builders["help", size, ratio] = lambda: _centered_panel(HELP_LINES, size, ratio, 0.5)
        self._panels = {key: self._panels.get(key) or build() for key, build in builders.items()}
        return list(self._panels.values())


def _centered_panel(
    rows: Sequence[tuple[str, str]], size: tuple[int, int], ratio: float, height: float
) -> Panel:
    """Return a text panel, centred horizontally, at a fraction of the surface's free height."""
    picture = paragraph(rows, ratio)
    left = max(0, (size[0] - picture.shape[1]) // 2)
    return Panel(picture, (left, max(0, round((size[1] - picture.shape[0]) * height))))


def _wrap_text(text: str, width: float) -> list[str]:
    columns = max(20, int(width / _CHARACTER_WIDTH))
    return [part for line in text.splitlines() for part in textwrap.wrap(line.strip(), columns)]
