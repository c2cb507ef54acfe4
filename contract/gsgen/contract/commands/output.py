"""Where commands write: styled on a terminal, plain elsewhere, whole files or none."""

__all__ = ["append_text", "show", "write_text"]

import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import typer

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import is_device
from gsgen.contract.reporters.text import Line


def show(lines: Iterable[Line]) -> None:
    """Print lines to stdout, in colour where stdout is a terminal that wants it."""
    if not sys.stdout.isatty() or "NO_COLOR" in os.environ:
        for line in lines:
            typer.echo(line.text)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False)
    for line in lines:
        console.print(Text(line.text, style=line.style), soft_wrap=True)


def append_text(path: Path, text: str) -> None:
    """Add to the end of a file that others write, too.

    Raises:
        ConfigInvalid: The file cannot be written.
    """
    try:
        with path.open("a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
    except OSError as error:
        raise ConfigInvalid(
            f"cannot be written: {error.strerror}", where=str(path)
        ) from error


def write_text(path: Path, text: str) -> None:
    """Write a file beside its place and rename it, so that a failure leaves what was there.

    What is no file, /dev/stdout for example, is written to as it is.

    Raises:
        ConfigInvalid: The file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if is_device(path):
            with path.open("w", encoding="utf-8", errors="backslashreplace") as device:
                device.write(text)
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, "utf-8", errors="backslashreplace")
        temporary.replace(path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        raise ConfigInvalid(
            f"cannot be written: {error.strerror}", where=str(path)
        ) from error
