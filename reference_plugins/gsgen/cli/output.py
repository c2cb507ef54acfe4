"""Prints validation reports and errors, and writes report files atomically."""

__all__ = ["append_text", "echo_error", "show", "write_text"]

import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from gsgen.cli.progress import clear
from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.contract.process.atomic_files import atomic_write, is_device, similar_file_hint

if TYPE_CHECKING:
    from gsgen.contract.reporters.text import Line


def show(lines: "Iterable[Line]") -> None:
    """Print styled lines to stdout; colour needs a terminal or FORCE_COLOR, and no NO_COLOR."""
    is_coloured = sys.stdout.isatty() or os.environ.get("FORCE_COLOR")
    if not is_coloured or "NO_COLOR" in os.environ:
        for line in lines:
            typer.echo(line.text)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False)
    for line in lines:
        console.print(Text(line.text, style=line.style), soft_wrap=True)


def echo_error(error: GsgenError) -> None:
    """Print an error to stderr; for a missing file, suggest a similar file name in its folder."""
    clear()
    if not error.hint and "No such file" in error.message:
        error.hint = similar_file_hint(str(error).partition(": ")[0])
    first, *other_lines = str(error).split("\n")
    lines = [line if line.startswith(" ") else f"  {line}" for line in other_lines]
    typer.echo("\n".join((f"gsgen: {first}", *lines)), err=True)


def append_text(path: Path, text: str) -> None:
    """Append text to a file to which other programs may write at the same time."""
    try:
        with path.open("a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
    except OSError as error:
        raise ConfigInvalid(f"cannot be written: {error.strerror}", where=str(path)) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically: under a temporary name, then renamed.

    A device such as /dev/stdout is written to directly.
    """
    if not is_device(path):
        with atomic_write(path) as draft:
            draft.write_text(text, "utf-8", errors="backslashreplace")
        return
    try:
        with path.open("w", encoding="utf-8", errors="backslashreplace") as device:
            device.write(text)
    except OSError as error:
        raise ConfigInvalid(f"cannot be written: {error.strerror}", where=str(path)) from error
