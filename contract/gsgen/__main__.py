"""Runs the `gsgen` program by `python -m gsgen`."""

from gsgen.cli import main

main()
