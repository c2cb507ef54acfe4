"""The `gsgen` program, whose commands come from the installed packages."""

__all__ = ["main"]

from gsgen.cli.app import main
