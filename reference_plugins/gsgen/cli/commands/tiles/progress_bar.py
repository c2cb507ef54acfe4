"""Shows the progress of a tileset build as a bar in a terminal."""

__all__ = ["BarProgress"]

import time
from typing import Any, final

from gsgen.cli.progress import display_of
from gsgen.contract._safe_text import printable
from gsgen.tiles.build.progress import Progress


@final
class BarProgress(Progress):
    """Draws a progress bar on stderr: the phase, splats per second, and the remaining time."""

    def __init__(self) -> None:
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

        self._progress_bar = display_of(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f} splats"),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
        )
        self._console = self._progress_bar.console
        self._task_id: Any = None
        self._start_time, self._splats_done = 0.0, 0

    def __enter__(self) -> "BarProgress":
        if self._console.is_terminal:
            self._progress_bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._console.is_terminal:
            self._progress_bar.stop()

    def begin(self, phase: str, total: int) -> None:
        """Show the progress bar of a phase of a tileset build."""
        if self._task_id is not None:
            self._progress_bar.remove_task(self._task_id)
        self._start_time, self._splats_done = time.monotonic(), 0
        self._task_id = self._progress_bar.add_task(phase, total=total, rate="")

    def advance(self, splats: int) -> None:
        """Advance the progress bar of a tileset build by a number of splats."""
        self._splats_done += splats
        elapsed_seconds = time.monotonic() - self._start_time
        rate = f"{self._splats_done / elapsed_seconds:,.0f}/s" if elapsed_seconds > 0.5 else ""
        self._progress_bar.update(self._task_id, completed=self._splats_done, rate=rate)

    def note(self, message: str) -> None:
        """Print a message about a tileset build above the progress bar."""
        self._console.print(f"note: {printable(message)}", markup=False, highlight=False)
