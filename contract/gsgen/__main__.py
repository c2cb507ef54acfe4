"""`python -m gsgen` is `gsgen`."""

from gsgen.cli import main

main()
