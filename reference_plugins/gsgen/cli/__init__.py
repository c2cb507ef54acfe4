"""The `gsgen` program: which command did the user type, and which functions does it run?"""

__all__ = ["main"]

from gsgen.cli.app import main
