"""Lets Ctrl-C end a command within seconds, even during a computation in C++.

Python raises KeyboardInterrupt between two of its own instructions: not while ONNX Runtime or a
driver computes, nor while it waits at exit for a thread that never ends. A user who types Ctrl-C then
would have to kill the process.
"""

__all__ = ["Interrupts", "ending_at_interrupts"]

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final, final

from gsgen.contract.errors import ExitCode

_GRACE_SECONDS: Final = 2.0
_STOP_BYTE: Final = b"\0"  # no signal has this number


@final
@dataclass(slots=True)
class Interrupts:
    """Records whether the user has asked the process to stop."""

    requested: threading.Event = field(default_factory=threading.Event)


@contextmanager
def ending_at_interrupts(seconds: float = _GRACE_SECONDS) -> Iterator[Interrupts]:
    """End this process some seconds after an interrupt, unless it has ended by itself.

    The timer keeps running after the block, since Python waits for threads at exit.

    Args:
        seconds: Time that KeyboardInterrupt handlers have, e.g. to remove unfinished files.
    """
    interrupts = Interrupts()
    if threading.current_thread() is not threading.main_thread():
        yield interrupts  # only the main thread receives signals
        return
    read_end, write_end = os.pipe()
    if os.name != "nt":  # Windows needs no non-blocking descriptor
        os.set_blocking(write_end, False)
    watch_thread = threading.Thread(
        target=_watch_signals, args=(read_end, interrupts, seconds), name="interrupts", daemon=True
    )
    previous_fd = signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    watch_thread.start()
    try:
        yield interrupts
    finally:
        signal.set_wakeup_fd(previous_fd)
        os.write(write_end, _STOP_BYTE)
        watch_thread.join()
        os.close(write_end)
        os.close(read_end)


def _watch_signals(read_end: int, interrupts: Interrupts, seconds: float) -> None:
    while (number := os.read(read_end, 1)) != _STOP_BYTE:
        if number[0] == signal.SIGINT and not interrupts.requested.is_set():
            interrupts.requested.set()
            end = threading.Timer(seconds, os._exit, (ExitCode.INTERRUPTED,))
            end.daemon = True
            end.start()
