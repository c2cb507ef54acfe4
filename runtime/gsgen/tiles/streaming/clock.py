"""Clocks of tile streaming: real time, or the time of a simulation."""

__all__ = ["Clock", "SystemClock"]

import time
from typing import Protocol, final


class Clock(Protocol):
    """Protocol of clocks: the time of a streaming session."""

    def now(self) -> float:
        """Return the clock's time in seconds, which never decreases."""
        ...


@final
class SystemClock:
    """A clock that counts real seconds since it was created."""

    def __init__(self) -> None:
        self._start_seconds = time.monotonic()

    def now(self) -> float:
        """Return the real seconds since the clock was created."""
        return time.monotonic() - self._start_seconds
