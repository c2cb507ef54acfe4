"""Shows the progress of a long command in one line on stderr, on terminals only.

A text such as ``frame 3 of 10`` becomes a bar with the rate and the remaining time.
"""

__all__ = ["clear", "display_of", "progress"]

import re
import sys
from typing import TYPE_CHECKING, Final

from gsgen.cli.text_streams import unescaped
from gsgen.contract._safe_text import printable

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

_COUNT_PATTERN: Final = re.compile(r"(?P<done>\d+) of (?P<total>\d+)\b")


class _ProgressLine:
    """The progress line of a command: a rich display and its current task."""

    def __init__(self) -> None:
        self.display: Progress | None = None
        self.shown_count = ("", 0)

    def show(self, words: str) -> None:
        """Show a text on the progress line, with a progress bar if it has a count such as 3/9."""
        if self.display is None:
            self.display = _open_display()
            self.display.start()
        match = _COUNT_PATTERN.search(words)
        shown_count = (_COUNT_PATTERN.sub("", words), int(match["total"])) if match else ("", 0)
        task_ids = self.display.task_ids
        if not task_ids or shown_count != self.shown_count or not match:
            for task_id in task_ids:
                self.display.remove_task(task_id)
            self.display.add_task(words, total=shown_count[1] if match else None)
            self.shown_count = shown_count
        completed_step_count = int(match["done"]) if match else None
        self.display.update(
            self.display.task_ids[0], description=f"{words} …", completed=completed_step_count
        )

    def close(self) -> None:
        """Erase the progress line, and show the terminal's cursor again."""
        if self.display is not None:
            self.display.stop()
            self.display = None
            self.shown_count = ("", 0)


def _open_display() -> "Progress":
    import atexit

    from rich.progress import (
        BarColumn,
        ProgressColumn,
        SpinnerColumn,
        Task,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class RateColumn(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(f"{task.speed:.3g}/s" if task.total and task.speed else "")

    class RemainingColumn(TimeRemainingColumn):
        def render(self, task: Task) -> Text:
            return super().render(task) if task.total else Text("")

    atexit.register(clear)  # the display hides the cursor
    return display_of(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        RateColumn(),
        RemainingColumn(),
        TimeElapsedColumn(),
    )


def display_of(*columns: "ProgressColumn") -> "Progress":
    """Return a progress display of the rich library on stderr, which is erased when work ends."""
    from rich.console import Console
    from rich.progress import Progress

    return Progress(
        *columns,
        console=Console(file=unescaped(sys.stderr)),
        transient=True,
        # rich's stand-in for stderr would write UTF-8 past the transliteration.
        redirect_stdout=False,
        redirect_stderr=False,
    )


_progress_line: Final = _ProgressLine()


def progress(words: str) -> None:
    """Replace the text of the progress line on stderr."""
    if sys.stderr.isatty():
        _progress_line.show(printable(words))


def clear() -> None:
    """Erase the progress line on stderr."""
    _progress_line.close()
