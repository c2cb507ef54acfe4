"""Lets Ctrl-C, SIGTERM and SIGHUP end a command within seconds, even during a computation in C++.

Python raises KeyboardInterrupt between two of its own instructions: not while ONNX Runtime or a
driver computes, nor while it waits at exit for a thread that never ends. A user who types Ctrl-C then
would have to kill the process. SIGTERM and SIGHUP end a process at once, without removing its
drafts and ending its children, and do nothing at all to the first process of a container; so here they
raise a KeyboardInterrupt, too.
"""

__all__ = [
    "ENDING_SIGNALS",
    "InterruptHandler",
    "OutOfTime",
    "Terminated",
    "end_on_interrupt",
    "require_time",
    "time_limit",
]

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import Final, final

from gsgen.contract.errors import ExitCode
from gsgen.contract.process.drafts import remove_own_drafts

_GRACE_SECONDS: Final = 2.0
_WATCHER_STOP_BYTE: Final = b"\0"  # no signal has this number
_SIGNAL_EXIT_CODE_BASE: Final = (
    128  # shells add it to the number of the signal that ended a process
)

ENDING_SIGNALS: Final[frozenset[int]] = frozenset(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""The signals by which a system asks a process to end; Windows has no SIGHUP."""


class Terminated(KeyboardInterrupt):
    """Raised in the main thread at SIGTERM and SIGHUP: the system asks the process to end."""


class OutOfTime(KeyboardInterrupt):
    """Raised in the main thread when the time of :func:`time_limit` is over.

    Who goes on with a part of the work cancels ``guard``, which ends the process otherwise.
    """

    def __init__(self, seconds: float, guard: threading.Timer) -> None:
        super().__init__(f"out of time after {seconds:g} s (--timeout)")
        self.guard = guard


_out_of_time: Final[list[OutOfTime]] = []  # what was raised in the present time limit


def require_time() -> None:
    """Raise OutOfTime once more if the time is over, which a part of the work went on without."""
    for error in _out_of_time:
        raise error


@contextmanager
def time_limit(seconds: float | None, late_message: str) -> Iterator[None]:
    """Raise OutOfTime once in a block that takes longer.

    A block that does not end within the grace time, such as one call into C++, ends the process
    with exit code 1: its drafts are removed, and ``late_message`` is printed. Windows has no alarms,
    so there every block ends in this way.

    Args:
        seconds: Time of the clock; no limit if absent, or outside of the main thread.
        late_message: A line for standard error.
    """
    if seconds is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    arguments = (ExitCode.FAILURE, f"{late_message}\n")
    guard = threading.Timer(seconds + _GRACE_SECONDS, _end_process, arguments)
    guard.daemon = True

    def raise_out_of_time(number: int, frame: FrameType | None) -> None:
        _out_of_time.append(OutOfTime(seconds, guard))
        require_time()

    has_alarms = hasattr(signal, "setitimer")
    if has_alarms:
        previous_handler = signal.signal(signal.SIGALRM, raise_out_of_time)
        signal.setitimer(signal.ITIMER_REAL, seconds)
    guard.start()
    try:
        yield
    finally:
        guard.cancel()
        _out_of_time.clear()
        if has_alarms:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, previous_handler)


@final
@dataclass(slots=True)
class InterruptHandler:
    """Records whether the user or the system has asked the process to end.

    Attributes:
        requested: Set at the first signal.
        exit_code: 128 + the number of that signal; 130 for Ctrl-C.
    """

    requested: threading.Event = field(default_factory=threading.Event)
    exit_code: ExitCode = ExitCode.INTERRUPTED


@contextmanager
def end_on_interrupt(seconds: float = _GRACE_SECONDS) -> Iterator[InterruptHandler]:
    """Raise KeyboardInterrupt at Ctrl-C, SIGTERM and SIGHUP; end the process if it goes on.

    The timer keeps running after the block, since Python waits for threads at exit. Its end removes
    the drafts of the process. A signal that the process ignores (as under nohup) or handles by
    itself stays so.

    Args:
        seconds: Time that KeyboardInterrupt handlers have, e.g. to remove unfinished files.
    """
    interrupts = InterruptHandler()
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
    raise_terminated = _raise_once_handler()
    handled_signals = [
        number for number in ENDING_SIGNALS if signal.getsignal(number) is signal.SIG_DFL
    ]
    for number in handled_signals:
        signal.signal(number, raise_terminated)
    try:
        yield interrupts
    finally:
        for number in handled_signals:
            signal.signal(number, signal.SIG_DFL)
        signal.set_wakeup_fd(previous_fd)
        os.write(write_end, _WATCHER_STOP_BYTE)
        watch_thread.join()
        os.close(write_end)
        os.close(read_end)


def _raise_once_handler() -> Callable[[int, FrameType | None], None]:
    """Return a signal handler that raises Terminated at the first signal, and ignores others.

    A second signal would interrupt the removal of unfinished files.
    """
    is_raised = False

    def raise_terminated(number: int, frame: FrameType | None) -> None:
        nonlocal is_raised
        if not is_raised:
            is_raised = True
            raise Terminated(signal.Signals(number).name)

    return raise_terminated


def _watch_signals(read_end: int, interrupts: InterruptHandler, seconds: float) -> None:
    while (number := os.read(read_end, 1)) != _WATCHER_STOP_BYTE:
        is_ending_signal = number[0] == signal.SIGINT or number[0] in ENDING_SIGNALS
        if is_ending_signal and not interrupts.requested.is_set():
            interrupts.exit_code = ExitCode(_SIGNAL_EXIT_CODE_BASE + number[0])
            interrupts.requested.set()
            end = threading.Timer(seconds, _end_process, (interrupts.exit_code,))
            end.daemon = True
            end.start()


def _end_process(exit_code: int, message: str = "") -> None:
    remove_own_drafts()
    sys.stderr.write(message)
    sys.stderr.flush()
    os._exit(exit_code)
