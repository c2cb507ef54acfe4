"""Shows the progress of a long command on one line of stderr, on terminals only."""

__all__ = ["clear", "progress"]

import sys

import typer

_LINE = "\r\x1b[2K"


def progress(words: str) -> None:
    """Replace the text of the progress line on stderr."""
    if sys.stderr.isatty():
        typer.echo(f"{_LINE}{words} …", err=True, nl=False)


def clear() -> None:
    """Erase the progress line on stderr."""
    if sys.stderr.isatty():
        typer.echo(_LINE, err=True, nl=False)
