"""Prints lines, documents, reports and errors, and writes report files atomically.

Commands print by these functions alone: each escapes what could control a terminal.
"""

__all__ = [
    "append_text",
    "echo",
    "echo_commands",
    "echo_error",
    "echo_json",
    "echo_text",
    "show",
    "write_text",
]

import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsgen.cli.progress import clear
from gsgen.cli.text_streams import unescaped, with_shown_names
from gsgen.contract._safe_text import for_json, printable
from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.contract.process.atomic_files import atomic_write, is_device, similar_file_hint

if TYPE_CHECKING:
    from gsgen.contract.reporters.text import Line


def echo(*lines: object, err: bool = False) -> None:
    """Print each value as one line to stdout or stderr; newlines in it are escaped, too."""
    echo_text("\n".join(printable(str(line)) for line in lines), err=err)


def echo_text(text: str, *, err: bool = False, end: str = "\n") -> None:
    """Print a text of several lines, whose names were escaped by `printable` one by one."""
    stream = sys.stderr if err else sys.stdout
    stream.write(f"{text}{end}")
    stream.flush()


def echo_json(document: Any, *, indent: int | None = 2) -> None:
    """Print a document as JSON, by default indented."""
    echo_text(for_json(document, indent=indent))


def echo_commands(text: str) -> None:
    """Print workflow commands of GitHub, whose values were escaped one by one."""
    unescaped(sys.stdout).write(f"{with_shown_names(text)}\n")
    sys.stdout.flush()


def show(lines: "Iterable[Line]") -> None:
    """Print styled lines to stdout; colour needs a terminal or FORCE_COLOR, and no NO_COLOR."""
    is_coloured = sys.stdout.isatty() or os.environ.get("FORCE_COLOR")
    if not is_coloured or "NO_COLOR" in os.environ:
        for line in lines:
            echo(line.text)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False)
    for line in lines:
        console.print(Text(printable(line.text), style=line.style), soft_wrap=True)


def echo_error(error: GsgenError) -> None:
    """Print an error to stderr; for a missing file, suggest a similar file name in its folder."""
    clear()
    if not error.hint and "No such file" in error.message:
        error.hint = similar_file_hint(str(error).partition(": ")[0])
    text = str(error)
    if error.where:
        text = text.replace(error.where, printable(error.where))
    first, *other_lines = text.split("\n")
    echo(f"gsgen: {first}", err=True)
    for line in other_lines:
        echo(line if line.startswith(" ") else f"  {line}", err=True)


def append_text(path: Path, text: str) -> None:
    """Append text to a file to which other programs may write at the same time."""
    try:
        with path.open("a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(with_shown_names(text))
    except OSError as error:
        raise ConfigInvalid(f"cannot be written: {error.strerror}", where=str(path)) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically: under a temporary name, then renamed.

    A device such as /dev/stdout is written to directly; the path ``-`` is standard output.
    """
    if path == Path("-"):
        echo_text(text, end="")
    elif not is_device(path):
        with atomic_write(path) as draft:
            draft.write_text(with_shown_names(text), "utf-8", errors="backslashreplace")
    else:
        try:
            with path.open("w", encoding="utf-8", errors="backslashreplace") as device:
                device.write(with_shown_names(text))
        except OSError as error:
            raise ConfigInvalid(f"cannot be written: {error.strerror}", where=str(path)) from error
