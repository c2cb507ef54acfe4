"""Runs the `gsgen` program by `python -m gsgen.cli`."""

from gsgen.cli import main

main()
