"""The progress line: only on terminals, with a bar where it counts, and gone before any output."""

import io
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from gsgen.cli.commands.tiles.progress_bar import BarProgress
from gsgen.cli.fetched_inputs import _show_progress as show_download
from gsgen.cli.progress import clear, progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True

    def plain(self) -> str:
        return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", self.getvalue())


@contextmanager
def open_terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    """Replace stderr: not in a fixture, since pytest sets its own when a test is called."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "100")
    yield stream
    clear()


def test_nothing_is_shown_where_stderr_is_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    progress("reading model.onnx")
    clear()
    assert stream.getvalue() == ""


def test_a_text_is_shown_and_erased(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_terminal(monkeypatch) as terminal:
        progress("reading [model].onnx")
        clear()
    assert "reading [model].onnx …" in terminal.plain()
    assert "-:--:--" not in terminal.plain()
    assert terminal.getvalue().rstrip().endswith("\x1b[2K")
    assert terminal.getvalue().count("\x1b[?25l") == terminal.getvalue().count("\x1b[?25h")


def test_a_count_is_a_bar_with_the_remaining_time(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_terminal(monkeypatch) as terminal:
        for number in range(1, 5):
            progress(f"frame {number} of 8")
        clear()
    text = terminal.plain()
    assert "frame 4 of 8 …" in text
    assert "━" in text
    assert re.search(r"\d+:\d\d:\d\d|-:--:--", text)


def test_another_text_replaces_the_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_terminal(monkeypatch) as terminal:
        progress("frame 1 of 2")
        progress("writing film.mp4")
        clear()
    drawn = [line for line in re.split(r"[\r\n]", terminal.plain()) if line.strip()]
    assert "frame 1 of 2" in drawn[0]
    assert "writing film.mp4" in drawn[-1]
    assert "frame" not in drawn[-1]


def test_clear_without_progress_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_terminal(monkeypatch) as terminal:
        clear()
    assert terminal.getvalue() == ""


def test_texts_pass_the_transliteration_while_a_build_shows_its_bar(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """rich's stand-ins for the streams would write characters that the encoding lacks."""
    with open_terminal(monkeypatch) as terminal, BarProgress() as build:
        build.begin("leaves", 100)
        assert sys.stderr is terminal
        build.advance(50)
        build.note("[tile] 7 is empty")
    assert "note: [tile] 7 is empty" in terminal.plain()
    assert "50 of 100 splats" in terminal.plain()
    assert terminal.getvalue().count("\x1b[?25l") == terminal.getvalue().count("\x1b[?25h")


def test_a_download_is_shown_in_megabytes(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_terminal(monkeypatch) as terminal:
        show_download("https://a.example/b/c.ply?key=secret", 3 << 20, (9 << 20) - 5)
        show_download("hf://owner/name/model.onnx", 5 << 20, None)
    assert "fetching c.ply: 3 of 9 MB" in terminal.plain()
    assert "fetching model.onnx: 5 MB" in terminal.plain()
    assert "secret" not in terminal.plain()
