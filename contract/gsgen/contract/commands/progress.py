"""Progress of a long command: one line on stderr, on terminals only."""

__all__ = ["clear", "progress"]

import sys

import typer

_LINE = "\r\x1b[2K"


def progress(words: str) -> None:
    """Replace the progress line by ``words``."""
    if sys.stderr.isatty():
        typer.echo(f"{_LINE}{words} …", err=True, nl=False)


def clear() -> None:
    """Erase the progress line."""
    if sys.stderr.isatty():
        typer.echo(_LINE, err=True, nl=False)
