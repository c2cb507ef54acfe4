"""Lets stdout and stderr accept any text, by transliterating characters they cannot encode.

Output that is piped or redirected has the encoding of the system's locale: cp1252 on most Windows
machines, ASCII in the C locale. Printing ``→`` there raises UnicodeEncodeError.
"""

__all__ = ["accept_any_text", "transliterate"]

import codecs
import sys
import unicodedata
from io import TextIOWrapper
from typing import Final, TextIO

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
_TAG_MARKS: Final = {"<super>": "^", "<sub>": "_"}


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
    convert = _escape if is_json else _substitute
    return "".join(map(convert, error.object[error.start : error.end])), error.end


def _substitute(character: str) -> str:
    if character in _ASCII_SUBSTITUTES:
        return _ASCII_SUBSTITUTES[character]
    name = unicodedata.name(character, "")
    if name.startswith("GREEK SMALL LETTER ") and name.count(" ") == 3:
        return name.rpartition(" ")[2].lower()
    if name.startswith("GREEK CAPITAL LETTER ") and name.count(" ") == 3:
        return name.rpartition(" ")[2].title()
    tag, _, points = unicodedata.decomposition(character).partition(" ")
    base = chr(int(points, 16)) if tag in _TAG_MARKS and " " not in points else ""
    if base:
        return _TAG_MARKS[tag] + (base if base.isascii() else _substitute(base))
    if tag == "<fraction>":
        return unicodedata.normalize("NFKD", character).replace("⁄", "/")
    return _escape(character)


def _escape(character: str) -> str:
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
