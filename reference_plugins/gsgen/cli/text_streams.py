"""Lets stdout and stderr accept any text, and keeps it from controlling a terminal or a CI system.

Every command writes through these streams, so that no name of a stranger's file leaves unescaped,
even where a command or a plugin does not escape it. Output that is piped or redirected has the encoding of the system's locale: cp1252 on most Windows
machines, ASCII in the C locale. Printing ``→`` there raises UnicodeEncodeError.
"""

__all__ = [
    "SafeStream", "accept_any_text", "open_closed_streams", "safe_streams", "show_path_as",
    "transliterate", "unescaped", "with_shown_names",
]  # fmt: skip

import codecs
import os
import re
import sys
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from typing import Any, Final, TextIO, final

from gsgen.contract._safe_text import for_terminal, printable

_HANDLER_NAME: Final = "gsgen-transliterate"
_ASCII_ERROR_HANDLER: Final = "gsgen-ascii"
_ASCII_SUBSTITUTES: Final = {
    "→": "->", "←": "<-", "↔": "<->", "−": "-", "–": "-", "—": "-", "‑": "-", "…": "...",
    "×": "x", "·": "*", "÷": "/", "⁄": "/", "±": "+/-", "≤": "<=", "≥": ">=", "≠": "!=", "≈": "~",
    "√": "sqrt ", "∞": "inf", "∫": "integral ", "∈": "in", "‖": "||", "°": " deg", "′": "'",
    "‘": "'", "’": "'", "“": "'", "”": "'", "«": "<<", "»": ">>", "⌈": "ceil(", "⌉": ")",
    "•": "*", "✅": "[ok]", "❌": "[no]", "💥": "[crash]", "⛔": "[stop]", "🚫": "[none]",
    "✓": "[ok]", "✗": "[no]", "│": "|", "┃": "|", "─": "-", "━": "-", "├": "+", "└": "+",
    "╭": "+", "╮": "+", "╯": "+", "╰": "+", "╸": "-", "╺": "-", "█": "#", "▏": "|",
    "\xa0": " ", "\u202f": " ",
}  # fmt: skip
_ASCII_BY_MARKUP_TAG: Final = {"<super>": "^", "<sub>": "_"}
# What sets colours or erases a line, and variables that make typer use colours in a log.
_COLOUR_CODE_PATTERN: Final = re.compile(r"(\x1b\[[0-9;]*m|\r\x1b\[2K)")
_COLOUR_VARIABLES: Final = ("FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS")

_shown_names: Final[dict[str, str]] = {}
"""Path of a temporary copy, or of its folder → the address that the user typed."""


def show_path_as(path: str, name: str) -> None:
    """Let texts name a temporary copy of a file by the address that the user typed."""
    _shown_names[path] = printable(name)


def with_shown_names(text: str) -> str:
    """Return a text that names files as the user did."""
    for path, name in _shown_names.items():
        text = text.replace(path, name)
    return text


@final
class SafeStream:
    """A text stream that escapes what could control a terminal or a CI system.

    Args:
        stream: The stream to write to.
    """

    def __init__(self, stream: TextIO) -> None:
        self.unescaped = stream
        self._current_line = ""  # the current line; of a long one, its last characters
        self._has_colours = stream.isatty() or any(map(os.environ.get, _COLOUR_VARIABLES))

    def write(self, text: str) -> int:
        """Write a text with escape sequences of Python for characters without a glyph."""
        shown_text = with_shown_names(text)
        has_codes = self._has_colours and "\x1b" in shown_text
        parts = _COLOUR_CODE_PATTERN.split(shown_text) if has_codes else [shown_text]
        for number, part in enumerate(parts):
            is_colour = number % 2 == 1
            self.unescaped.write(part if is_colour else self._escape_text(part))
        return len(text)

    def _escape_text(self, text: str) -> str:
        first = text[:1]
        # A command of GitHub may come in pieces: `:` and `:`, or `##` and `[`.
        completes_command = (first == ":" and self._current_line.strip() == ":") or (
            f"{self._current_line[-2:]}{text[:2]}".find("##[") in (0, 1)
        )
        prefix = f"\\x{ord(first):x}" if completes_command else ""
        remainder = text[1:] if completes_command else text
        starts_line = not self._current_line.strip() and not prefix
        safe_text = prefix + for_terminal(remainder, starts_line=starts_line)
        line = f"{self._current_line}{text}".rpartition("\n")[2]
        self._current_line = line if line.strip() in ("", ":") else f"…{line[-2:]}"
        return safe_text

    def writelines(self, lines: Iterable[str]) -> None:
        """Write each of the texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unescaped, name)


@contextmanager
def safe_streams() -> Iterator[None]:
    """Let stdout and stderr be safe streams during the block."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = map(_safe_stream, streams)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams


def _safe_stream(stream: TextIO | None) -> Any:
    return stream if stream is None or isinstance(stream, SafeStream) else SafeStream(stream)


def unescaped(stream: TextIO) -> TextIO:
    """Return the stream below a safe stream, for text of which every part is escaped already."""
    return stream.unescaped if isinstance(stream, SafeStream) else stream


def open_closed_streams() -> None:
    """Open the standard streams that were closed when the process started, as by ``>&-``.

    The next file that the process opens would take the free descriptor, and receive what libraries
    print. Reading stdin gives nothing, writing to stdout fails, and stderr is discarded.
    """
    for name, number, mode, flags in (
        ("stdin", 0, "r", os.O_RDONLY),
        ("stdout", 1, "w", os.O_RDONLY),
        ("stderr", 2, "w", os.O_WRONLY),
    ):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, flags)
            if descriptor != number:
                os.dup2(descriptor, number)
                os.close(descriptor)
            setattr(sys, name, open(number, mode, encoding="utf-8"))  # noqa: SIM115 (for good)


def accept_any_text() -> None:
    """Configure stdout and stderr so that printing any text never raises an encoding error."""
    codecs.register_error(_HANDLER_NAME, transliterate)
    codecs.register(_ascii_codec)
    for stream in (sys.stdout, sys.stderr):
        _accept_any_text(stream)


def _accept_any_text(stream: TextIO | None) -> None:
    if not isinstance(stream, TextIOWrapper):  # pythonw has none, and tests replace it
        return
    if codecs.lookup(stream.encoding).name == "ascii":
        # click writes UTF-8 into streams whose encoding is named ASCII.
        stream.reconfigure(encoding=_ASCII_ERROR_HANDLER, errors=_HANDLER_NAME)
    else:
        stream.reconfigure(errors=_HANDLER_NAME)


def transliterate(error: UnicodeError) -> tuple[str, int]:
    """Return ASCII text for characters that an encoding lacks, as a Python codec error handler.

    An error handler of :mod:`codecs`. A JSON document gets escapes instead, which mean the same.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    is_json = error.object[:1] + error.object.rstrip()[-1:] in ("{}", "[]")
    convert = _escape_character if is_json else _ascii_substitute
    return "".join(map(convert, error.object[error.start : error.end])), error.end


def _ascii_substitute(character: str) -> str:
    if character in _ASCII_SUBSTITUTES:
        return _ASCII_SUBSTITUTES[character]
    name = unicodedata.name(character, "")
    if name.startswith("GREEK SMALL LETTER ") and name.count(" ") == 3:
        return name.rpartition(" ")[2].lower()
    if name.startswith("GREEK CAPITAL LETTER ") and name.count(" ") == 3:
        return name.rpartition(" ")[2].title()
    tag, _, points = unicodedata.decomposition(character).partition(" ")
    base = chr(int(points, 16)) if tag in _ASCII_BY_MARKUP_TAG and " " not in points else ""
    if base:
        return _ASCII_BY_MARKUP_TAG[tag] + (base if base.isascii() else _ascii_substitute(base))
    if tag == "<fraction>":
        return unicodedata.normalize("NFKD", character).replace("⁄", "/")
    return _escape_character(character)


def _escape_character(character: str) -> str:
    """Return the JSON escape sequences (hexadecimal) of a character."""
    pairs = character.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{pairs[start : start + 4]}" for start in range(0, len(pairs), 4))


def _ascii_codec(name: str) -> codecs.CodecInfo | None:
    if name.replace("_", "-") != _ASCII_ERROR_HANDLER:
        return None
    ascii_info = codecs.lookup("ascii")
    return codecs.CodecInfo(
        ascii_info.encode,
        ascii_info.decode,
        streamreader=ascii_info.streamreader,
        streamwriter=ascii_info.streamwriter,
        incrementalencoder=ascii_info.incrementalencoder,
        incrementaldecoder=ascii_info.incrementaldecoder,
        name=_ASCII_ERROR_HANDLER,
    )
