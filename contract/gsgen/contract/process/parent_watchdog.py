"""Starts child processes of Python, and ends them when their parent process dies.

No child imports a module of the working directory: it may hold files of strangers, such as a
``typer.py`` in a repository that is checked. The parent kills a child that takes too long; a parent
that was killed cannot.
"""

__all__ = [
    "child_environment",
    "exit_with_parent",
    "prepare_worker",
    "python_command",
    "safe_multiprocessing",
]

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Never

from gsgen.contract.process.drafts import remove_own_drafts
from gsgen.contract.process.interrupts import ENDING_SIGNALS

_POLL_SECONDS: Final = 0.5
_PARENT_VARIABLE: Final = "GSGEN_PARENT_PROCESS"
_SAFE_PATH_VARIABLE: Final = "PYTHONSAFEPATH"


def python_command() -> list[str]:
    """Return the first words of a command that starts this Python, as isolated as this process.

    The module path starts without the working directory, and without ``PYTHONPATH`` and the user's
    packages if this process runs with ``-I``.
    """
    flags = sys.flags
    if flags.isolated:
        options = ["-I"]
    else:
        options = ["-P"]
        options += ["-E"] if flags.ignore_environment else []
        options += ["-s"] if flags.no_user_site else []
    return [sys.executable, *options, *(["-X", "utf8"] if flags.utf8_mode else [])]


@contextmanager
def safe_multiprocessing() -> Iterator[None]:
    """Let processes that ``multiprocessing`` starts in the block not import from the working directory.

    They inherit the options of this process, such as ``-I``, but are started with ``-c``, which
    would search the working directory first.
    """
    previous_setting = os.environ.get(_SAFE_PATH_VARIABLE)
    os.environ[_SAFE_PATH_VARIABLE] = "1"
    try:
        yield
    finally:
        if previous_setting is None:
            del os.environ[_SAFE_PATH_VARIABLE]
        else:
            os.environ[_SAFE_PATH_VARIABLE] = previous_setting


def child_environment() -> dict[str, str]:
    """Return this process's environment variables for a child that calls `exit_with_parent`.

    A virtual environment's Python on Windows is a launcher: the child's parent is the launcher.
    """
    return os.environ | {_PARENT_VARIABLE: str(os.getpid())}


def prepare_worker() -> None:
    """Make this process a worker: it ends with its parent or at its parent's SIGTERM.

    Ctrl-C reaches the whole process group, and the parent decides what it means.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in ENDING_SIGNALS:
        signal.signal(number, lambda *_: _end_process())
    exit_with_parent()


def exit_with_parent() -> None:
    """Start a thread that ends this process when its parent process has died."""
    watch = _watch_parent_on_windows if os.name == "nt" else _watch_parent
    threading.Thread(target=watch, args=(os.getppid(),), name="lifeline", daemon=True).start()


def _watch_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_POLL_SECONDS)
    _end_process()


def _watch_parent_on_windows(parent: int) -> None:
    from gsgen.contract.process.windows import wait_for_exit

    wait_for_exit(int(os.environ.get(_PARENT_VARIABLE, parent)))
    _end_process()


def _end_process() -> Never:
    remove_own_drafts()
    os._exit(1)  # a run of ONNX Runtime cannot be interrupted
