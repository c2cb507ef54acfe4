"""Escapes text where it leaves gsgen: one function for each destination.

Names and messages come from files of strangers. Printed as they are, they could erase lines of a
terminal, reverse the order of its characters, start a command of a CI system, or add markup to a
report.
"""

__all__ = [
    "for_html",
    "for_json",
    "for_markdown",
    "for_shell",
    "for_terminal",
    "for_yaml",
    "is_plain_name",
    "printable",
    "read_utf8",
    "safe_json",
    "without_commands",
]

import codecs
import html
import json
import re
import shlex
import unicodedata
from pathlib import Path
from typing import Any, Final

# Characters without a glyph that Python calls printable: joiners, fillers, variation selectors.
_INVISIBLE_CHARACTER_PATTERN: Final = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u3164\uffa0\ufe00-\ufe0f\U000e0100-\U000e01ef]"
)
# GitHub runs commands that start with `::` at the start of a line, or with `##[` anywhere.
_WORKFLOW_COMMAND_PATTERN: Final = re.compile(r"(?m)^(\s*):(?=:)")
_OLD_COMMAND: Final = re.compile(r"#(?=#\[)")
_MARKUP: Final = re.compile(r"([\\`*_\[\]<>|~@&#])")
_SHELL_ESCAPES: Final = {"\\": r"\\", "'": r"\'", "\n": r"\n", "\t": r"\t"}


def read_utf8(path: Path) -> str:
    """Return the text of a file that a user wrote, without a byte order mark.

    Raises:
        OSError: The file cannot be read.
        UnicodeError: It is not UTF-8; the message names UTF-16, which some shells write.
    """
    content = path.read_bytes()
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise UnicodeError("it is text in UTF-16, expected UTF-8")
    return content.decode("utf-8-sig")


def printable(text: str, *, kept_chars: str = "") -> str:
    r"""Return a name or message as one line: all but ``kept_chars`` have a glyph, or are spaces.

    Control characters, marks that change the direction of text, and invisible characters become
    escape sequences of Python, such as ``\x1b``.
    """
    if text.isprintable() and not _INVISIBLE_CHARACTER_PATTERN.search(text):
        return text
    return "".join(c if _has_glyph(c) or c in kept_chars else _escape_character(c) for c in text)


def _has_glyph(character: str) -> bool:
    return character.isprintable() and not _INVISIBLE_CHARACTER_PATTERN.match(character)


def _escape_character(character: str) -> str:
    return ascii(character)[1:-1]


def for_terminal(text: str, *, starts_line: bool = True) -> str:
    """Return a text of several lines for a terminal or a log; tabs and wide spaces stay.

    Args:
        text: The text.
        starts_line: Whether it starts a line, where CI systems read commands.
    """
    lines = [
        line
        if line.isprintable() and not _INVISIBLE_CHARACTER_PATTERN.search(line)
        else _escape_for_terminal(line)
        for line in text.split("\n")
    ]
    safe_text = "\n".join(lines)
    if "::" in safe_text:
        start = 0 if starts_line else safe_text.find("\n") % (len(safe_text) + 1)
        safe_text = safe_text[:start] + _WORKFLOW_COMMAND_PATTERN.sub(r"\1\\x3a", safe_text[start:])
    return _OLD_COMMAND.sub(r"\\x23", safe_text)


def _escape_for_terminal(line: str) -> str:
    return "".join(
        c if _has_glyph(c) or c == "\t" or unicodedata.category(c) == "Zs" else _escape_character(c)
        for c in line
    )


def without_commands(text: str, *, kept_chars: str = "") -> str:
    """Return a printable text without commands of GitHub, also if it starts a line."""
    return for_terminal(printable(text, kept_chars=kept_chars))


def for_json(document: Any, *, indent: int | None = 2) -> str:
    """Return a document as JSON text for any destination: see `safe_json`."""
    return safe_json(json.dumps(document, indent=indent, ensure_ascii=False))


def safe_json(text: str) -> str:
    """Return JSON text in which characters without a glyph are escape sequences of JSON.

    They occur within strings alone, where these mean the same.
    """
    lines = [
        line
        if line.isprintable() and not _INVISIBLE_CHARACTER_PATTERN.search(line)
        else "".join(c if _has_glyph(c) else json.dumps(c)[1:-1] for c in line)
        for line in text.split("\n")
    ]
    return _OLD_COMMAND.sub(r"\\u0023", "\n".join(lines))


def for_yaml(text: str) -> str:
    """Return a text as a quoted scalar of YAML, which is the same as a string of JSON."""
    return json.dumps(printable(text), ensure_ascii=False)


def for_html(text: str) -> str:
    """Return a text for the content of an element or for a quoted attribute; lines stay."""
    return html.escape(printable(text, kept_chars="\n"))


def for_markdown(text: str) -> str:
    """Return a text outside a code span, in which no character formats, links or mentions."""
    return _MARKUP.sub(r"\\\1", printable(text))


def for_shell(path: str) -> str:
    """Return the name of a file as a word of a shell's command line, never an option."""
    word = f"./{path}" if path.startswith("-") else path
    if printable(word) == word:
        return shlex.quote(word)
    return f"$'{''.join(map(_shell_escape, word))}'"


def _shell_escape(character: str) -> str:
    code = ord(character)
    if character in _SHELL_ESCAPES:
        return _SHELL_ESCAPES[character]
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a file's name that is not UTF-8
        return f"\\x{code - 0xDC00:02x}"
    if 0x80 <= code <= 0xFF and not _has_glyph(character):  # \x80 would be a byte
        return f"\\u{code:04x}"
    return character if _has_glyph(character) else _escape_character(character)


def is_plain_name(name: str) -> bool:
    """Return whether the name of a tensor is printable and has no blank: tools may trim it."""
    return name.isprintable() and " " not in name
