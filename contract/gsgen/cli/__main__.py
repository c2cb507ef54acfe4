"""`python -m gsgen.cli` is `gsgen`."""

from gsgen.cli import main

main()
