"""What a long command shows while it works: one line on stderr, where someone is watching."""

__all__ = ["clear", "progress"]

import sys

import typer

_LINE = "\r\x1b[2K"


def progress(words: str) -> None:
    """Show what is being done, in place of what was shown before."""
    if sys.stderr.isatty():
        typer.echo(f"{_LINE}{words} …", err=True, nl=False)


def clear() -> None:
    """Remove the line before results are printed."""
    if sys.stderr.isatty():
        typer.echo(_LINE, err=True, nl=False)
