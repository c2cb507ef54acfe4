"""Reports the progress of a tileset build, as JSON lines for programs or by a class of yours."""

__all__ = ["JsonProgress", "Progress", "SilentProgress"]

import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol, final

from gsgen.tiles.format.json_values import JsonDict


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
class SilentProgress(Progress):
    """A progress display of tileset builds that shows nothing."""

    def __enter__(self) -> "SilentProgress":
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
        self._phase_name, self._splat_total, self._splats_done = "", 0, 0
        self._start_time = self._last_write_time = time.monotonic()

    def __enter__(self) -> "JsonProgress":
        return self

    def __exit__(self, *error: object) -> None: ...

    def begin(self, phase: str, total: int) -> None:
        """Write a JSON line for the beginning of a phase of a tileset build."""
        self._phase_name, self._splat_total, self._splats_done = phase, total, 0
        self._start_time = time.monotonic()
        self._write_line()

    def advance(self, splats: int) -> None:
        """Write the build's progress as a JSON line, once a second and when all splats are done."""
        self._splats_done += splats
        if self._splats_done == self._splat_total or time.monotonic() - self._last_write_time >= 1:
            self._write_line()

    def note(self, message: str) -> None:
        """Write a message about a tileset build as a JSON line."""
        self._emit_event({"event": "note", "message": message})

    def _write_line(self) -> None:
        self._last_write_time = time.monotonic()
        elapsed_seconds = self._last_write_time - self._start_time
        rate = self._splats_done / elapsed_seconds if elapsed_seconds > 0 else 0.0
        event: JsonDict = {
            "event": "progress",
            "phase": self._phase_name,
            "done": self._splats_done,
            "total": self._splat_total,
            "splats_per_second": round(rate),
            "eta_seconds": round((self._splat_total - self._splats_done) / rate, 1)
            if rate
            else None,
        }
        self._emit_event(event)

    def _emit_event(self, event: JsonDict) -> None:
        self._write(json.dumps(event))
