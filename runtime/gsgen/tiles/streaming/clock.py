"""Clocks: the time of a session, or of a simulation that runs as fast as it can."""

__all__ = ["Clock", "SystemClock"]

import time
from typing import Protocol, final


class Clock(Protocol):
    """Protocol of clocks: the time of a streaming session."""

    def now(self) -> float:
        """Return seconds since some moment; never fewer than before."""
        ...


@final
class SystemClock:
    """Seconds since the clock was made."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def now(self) -> float:
        """Return seconds since the clock was made."""
        return time.monotonic() - self._start
