"""What benches share: how they print a figure, and how they time an action."""

__all__ = ["print_figure", "print_line", "process_seconds"]

import sys
import time
from collections.abc import Callable


def print_figure(text: str) -> None:
    """Print a line among pytest's own output."""
    sys.stdout.write(f"\n  {text}")
    sys.stdout.flush()


def print_line(text: str) -> None:
    """Print a line of a bench that is a program of its own."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def process_seconds(action: Callable[[], object]) -> float:
    """Return seconds of the processor: others may be at work on the machine."""
    start_time = time.process_time()
    action()
    return time.process_time() - start_time
