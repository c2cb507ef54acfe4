"""Stdout and stderr escape what is written to them, by any code and in any pieces."""

import io
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsgen.cli.text_streams import SafeStream, safe_streams, unescaped

PIECES = st.lists(st.sampled_from(["::", ":", "error::x", " ", "\n", "\x1b[31m", "\x1b[2J", "\u202e", "#", "##[", "[", "a"]))  # fmt: skip


class Terminal(io.StringIO):
    """A text stream that says that it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def _without_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS"):
        monkeypatch.delenv(name, raising=False)


def written(pieces: list[str], stream: io.StringIO) -> str:
    safe = SafeStream(stream)
    for piece in pieces:
        assert safe.write(piece) == len(piece)
    return stream.getvalue()


@given(PIECES)
def test_pieces_of_a_line_are_no_command(pieces: list[str]) -> None:
    text = written(pieces, io.StringIO())
    assert not [line for line in text.split("\n") if line.lstrip().startswith("::")]
    assert not set(text) & {"\x1b", "\u202e"}
    assert "##[" not in text


@given(PIECES)
def test_terminal_gets_colours_and_nothing_else(pieces: list[str]) -> None:
    text = written(pieces, Terminal()).replace("\x1b[31m", "")
    assert not set(text) & {"\x1b", "\u202e"}


def test_print_and_tracebacks_are_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    with safe_streams():
        print("a\x1b[2J", "b\x9b")
        sys.stderr.writelines(["c\u202e\n", "::error::d\n"])
        unescaped(sys.stdout).write("::error::kept\n")
    captured = capsys.readouterr()
    assert captured.out == "a\\x1b[2J b\\x9b\n::error::kept\n"
    assert captured.err == "c\\u202e\n\\x3a:error::d\n"
