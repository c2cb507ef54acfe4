"""What a build reports while it runs: a bar for people, lines of JSON for programs."""

__all__ = ["BarProgress", "JsonProgress", "Progress", "Silent"]

import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol, final


class Progress(AbstractContextManager["Progress"], Protocol):
    """Is told of phases, and of the splats that each has done."""

    def begin(self, phase: str, total: int) -> None:
        """Begin ``phase``, which works on ``total`` splats."""
        ...

    def advance(self, splats: int) -> None:
        """Count ``splats`` as done."""
        ...

    def note(self, message: str) -> None:
        """Tell the user of something."""
        ...


@final
class Silent(Progress):
    """Reports nothing."""

    def __enter__(self) -> "Silent":
        """Return the object."""
        return self

    def __exit__(self, *error: object) -> None:
        """Do nothing."""

    def begin(self, phase: str, total: int) -> None:
        """Do nothing."""

    def advance(self, splats: int) -> None:
        """Do nothing."""

    def note(self, message: str) -> None:
        """Do nothing."""


@final
class JsonProgress(Progress):
    """Writes a line of JSON at the beginning of a phase, and at most one a second in it.

    Args:
        write: Takes a line.
    """

    def __init__(self, write: Callable[[str], object]) -> None:
        self._write = write
        self._phase, self._total, self._done = "", 0, 0
        self._began = self._written = time.monotonic()

    def __enter__(self) -> "JsonProgress":
        """Return the object."""
        return self

    def __exit__(self, *error: object) -> None:
        """Do nothing: every line is written at once."""

    def begin(self, phase: str, total: int) -> None:
        """Write the beginning of a phase."""
        self._phase, self._total, self._done = phase, total, 0
        self._began = time.monotonic()
        self._line()

    def advance(self, splats: int) -> None:
        """Write a line if the last is a second ago, or all is done."""
        self._done += splats
        if self._done == self._total or time.monotonic() - self._written >= 1:
            self._line()

    def note(self, message: str) -> None:
        """Write a note."""
        self._emit({"event": "note", "message": message})

    def _line(self) -> None:
        self._written = time.monotonic()
        elapsed = self._written - self._began
        rate = self._done / elapsed if elapsed > 0 else 0.0
        event: dict[str, Any] = {
            "event": "progress",
            "phase": self._phase,
            "done": self._done,
            "total": self._total,
            "splats_per_second": round(rate),
            "eta_seconds": round((self._total - self._done) / rate, 1) if rate else None,
        }
        self._emit(event)

    def _emit(self, event: dict[str, Any]) -> None:
        self._write(json.dumps(event))


@final
class BarProgress(Progress):
    """Draws a bar on stderr: the phase, splats a second, and the time that is left."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        self._console = Console(stderr=True)
        self._bar = Bar(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f} splats"),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
        )
        self._task: Any = None
        self._began, self._done = 0.0, 0

    def __enter__(self) -> "BarProgress":
        """Show the bar, where somebody can see it."""
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Remove the bar."""
        if self._console.is_terminal:
            self._bar.stop()

    def begin(self, phase: str, total: int) -> None:
        """Show the bar of a phase."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._began, self._done = time.monotonic(), 0
        self._task = self._bar.add_task(phase, total=total, rate="")

    def advance(self, splats: int) -> None:
        """Move the bar."""
        self._done += splats
        elapsed = time.monotonic() - self._began
        rate = f"{self._done / elapsed:,.0f}/s" if elapsed > 0.5 else ""
        self._bar.update(self._task, completed=self._done, rate=rate)

    def note(self, message: str) -> None:
        """Print a note above the bar."""
        self._console.print(f"note: {message}", markup=False, highlight=False)
