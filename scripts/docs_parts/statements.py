"""The numbered statements of the specification: paragraphs and points of its pages.

A statement begins with its number, which is an anchor as well. Tables and code up to the next one
belong to it. Its sentences count from 1. A number stays with its statement.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

# First letter of the numbers of each page.
LETTERS: Final = {
    "agreement.md": "A",
    "cells.md": "W",
    "clips.md": "K",
    "conventions.md": "C",
    "extensions.md": "E",
    "index.md": "I",
    "layout.md": "L",
    "levels.md": "V",
    "manifest.md": "M",
    "roles.md": "R",
    "targets.md": "T",
    "tilesets.md": "S",
}
NUMBERED: Final = re.compile(r'<a id="[a-z][0-9]+" href="#[a-z][0-9]+">([A-Z][0-9]+)</a> ')

# The start of a line that holds words of a statement, not those of a table, a heading, a comment or code.
_WORDS = re.compile(r"^\s*(?:(?:[-*]|[0-9]+\.)\s+)?(?=[^\s|#<`!-]|<a |`[^`]|-[^-])")
_SENTENCE_END = re.compile(r"(?<=[.!?])\s+(?=[A-Z`*(])")


def sentences(text: str) -> list[str]:
    """Return the sentences of a statement, without links and emphasis."""
    text = re.sub(r"\s*\(\[[A-Z]{2}[0-9]{3}\]\([^)]*\)\)", "", text)  # a rule in brackets
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)
    plain = " ".join(text.replace("**", "").replace("*", "").split())
    return _SENTENCE_END.split(plain)


def lines_of_statements(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield for each statement of a page its line, the text before its words, and its words."""
    is_code = is_generated = False
    for number, line in enumerate(text.splitlines()):
        if line.strip().startswith("```"):
            is_code = not is_code
        elif not is_code and line.startswith("<!-- generated:"):
            is_generated = True
        elif line.startswith("<!-- end generated"):
            is_generated = False
        elif not (is_code or is_generated) and (start := _WORDS.match(line)):
            yield number, start[0], line[start.end() :]


def statements(text: str) -> dict[str, list[str]]:
    """Return the sentences of each statement of a page, by its number; "" where it has none."""
    results: dict[str, list[str]] = {}
    for _, _, words in lines_of_statements(text):
        number = NUMBERED.match(words)
        results[number[1] if number else ""] = sentences(NUMBERED.sub("", words, count=1))
    return results


def numbered(text: str, page: str, taken: frozenset[str] = frozenset()) -> str:
    """Return a page whose statements all have a number: new ones get the next.

    Args:
        text: The page.
        page: The name of its file.
        taken: Numbers of former statements, which are not given again.
    """
    letter = LETTERS[page]
    used = {number for number in (*statements(text), *taken) if number.startswith(letter)}
    last = max((int(number[1:]) for number in used), default=0)
    lines = text.split("\n")
    for position, start, words in lines_of_statements(text):
        if not NUMBERED.match(words):
            last += 1
            anchor = f"{letter.lower()}{last}"
            lines[position] = f'{start}<a id="{anchor}" href="#{anchor}">{letter}{last}</a> {words}'
    return "\n".join(lines)


def pages(folder: Path) -> dict[Path, str]:
    """Return the pages of the specification with numbers, and the text of each."""
    kept = re.findall(
        r"^\| ([A-Z][0-9]+) \|", (folder / "requirements.md").read_text("utf-8"), re.M
    )
    return {
        folder / name: numbered((folder / name).read_text("utf-8"), name, frozenset(kept))
        for name in LETTERS
    }
