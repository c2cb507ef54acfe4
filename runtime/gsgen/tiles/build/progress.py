"""Reports the progress of a tileset build: a bar in a terminal, or JSON lines for programs."""

__all__ = ["BarProgress", "JsonProgress", "Progress", "Silent"]

import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol, final

from gsgen.contract.commands.progress import display_of
from gsgen.tiles.json_values import JsonDict


class Progress(AbstractContextManager["Progress"], Protocol):
    """Protocol: receives the phases of a build and the number of splats processed in each."""

    def begin(self, phase: str, total: int) -> None:
        """Begin a phase of a tileset build, which processes ``total`` splats."""
        ...

    def advance(self, splats: int) -> None:
        """Add to the number of splats that the build phase has processed."""
        ...

    def note(self, message: str) -> None:
        """Show a message about the build to the user."""
        ...


@final
class Silent(Progress):
    """A progress display of tileset builds that shows nothing."""

    def __enter__(self) -> "Silent":
        return self

    def __exit__(self, *error: object) -> None: ...

    def begin(self, phase: str, total: int) -> None:
        """Ignore the beginning of a phase of a tileset build."""

    def advance(self, splats: int) -> None:
        """Ignore the number of processed splats."""

    def note(self, message: str) -> None:
        """Ignore a message about the tileset build."""


@final
class JsonProgress(Progress):
    """Writes a build's progress as JSON lines: one as a phase begins, then one a second."""

    def __init__(self, write: Callable[[str], object]) -> None:
        self._write = write
        self._phase, self._total, self._splats_done = "", 0, 0
        self._start_time = self._written = time.monotonic()

    def __enter__(self) -> "JsonProgress":
        return self

    def __exit__(self, *error: object) -> None: ...

    def begin(self, phase: str, total: int) -> None:
        """Write a JSON line for the beginning of a phase of a tileset build."""
        self._phase, self._total, self._splats_done = phase, total, 0
        self._start_time = time.monotonic()
        self._line()

    def advance(self, splats: int) -> None:
        """Write the build's progress as a JSON line, once a second and when all splats are done."""
        self._splats_done += splats
        if self._splats_done == self._total or time.monotonic() - self._written >= 1:
            self._line()

    def note(self, message: str) -> None:
        """Write a message about a tileset build as a JSON line."""
        self._emit({"event": "note", "message": message})

    def _line(self) -> None:
        self._written = time.monotonic()
        elapsed = self._written - self._start_time
        rate = self._splats_done / elapsed if elapsed > 0 else 0.0
        event: JsonDict = {
            "event": "progress",
            "phase": self._phase,
            "done": self._splats_done,
            "total": self._total,
            "splats_per_second": round(rate),
            "eta_seconds": round((self._total - self._splats_done) / rate, 1) if rate else None,
        }
        self._emit(event)

    def _emit(self, event: JsonDict) -> None:
        self._write(json.dumps(event))


@final
class BarProgress(Progress):
    """Draws a progress bar on stderr: the phase, splats per second, and the remaining time."""

    def __init__(self) -> None:
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

        self._bar = display_of(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f} splats"),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
        )
        self._console = self._bar.console
        self._task: Any = None
        self._start_time, self._splats_done = 0.0, 0

    def __enter__(self) -> "BarProgress":
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._console.is_terminal:
            self._bar.stop()

    def begin(self, phase: str, total: int) -> None:
        """Show the progress bar of a phase of a tileset build."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._start_time, self._splats_done = time.monotonic(), 0
        self._task = self._bar.add_task(phase, total=total, rate="")

    def advance(self, splats: int) -> None:
        """Advance the progress bar of a tileset build by a number of splats."""
        self._splats_done += splats
        elapsed = time.monotonic() - self._start_time
        rate = f"{self._splats_done / elapsed:,.0f}/s" if elapsed > 0.5 else ""
        self._bar.update(self._task, completed=self._splats_done, rate=rate)

    def note(self, message: str) -> None:
        """Print a message about a tileset build above the progress bar."""
        self._console.print(f"note: {message}", markup=False, highlight=False)
