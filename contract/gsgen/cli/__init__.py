"""The `gsgen` program: a thin app that finds its commands among the installed packages."""

__all__ = ["main"]

from gsgen.cli.app import main
