"""Ctrl-C ends a command, whatever it is in the middle of.

Python raises KeyboardInterrupt between two of its own instructions: not while ONNX Runtime or a
driver computes, nor while it waits at exit for a thread that never ends. Whoever types Ctrl-C then
would have to find out how to kill a process.
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
_OVER: Final = b"\0"  # no signal has this number


@final
@dataclass(slots=True)
class Interrupts:
    """What is known of interrupts.

    Attributes:
        requested: Set once there was one.
    """

    requested: threading.Event = field(default_factory=threading.Event)


@contextmanager
def ending_at_interrupts(seconds: float = _GRACE_SECONDS) -> Iterator[Interrupts]:
    """End this process ``seconds`` after an interrupt, if it has not ended by itself.

    It goes on to be ended when the block is left: threads are waited for after that.

    Args:
        seconds: For KeyboardInterrupt to do what it can, such as removing unfinished files.
    """
    interrupts = Interrupts()
    if threading.current_thread() is not threading.main_thread():
        yield interrupts  # signals are the main thread's
        return
    read_end, write_end = os.pipe()
    if os.name != "nt":  # there, Python asks for no such thing
        os.set_blocking(write_end, False)
    watch = threading.Thread(
        target=_watch, args=(read_end, interrupts, seconds), name="interrupts", daemon=True
    )
    before = signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    watch.start()
    try:
        yield interrupts
    finally:
        signal.set_wakeup_fd(before)
        os.write(write_end, _OVER)
        watch.join()
        os.close(write_end)
        os.close(read_end)


def _watch(read_end: int, interrupts: Interrupts, seconds: float) -> None:
    while (number := os.read(read_end, 1)) != _OVER:
        if number[0] == signal.SIGINT and not interrupts.requested.is_set():
            interrupts.requested.set()
            end = threading.Timer(seconds, os._exit, (ExitCode.INTERRUPTED,))
            end.daemon = True
            end.start()
