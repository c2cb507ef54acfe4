"""Starts child processes of Python, and ends them when their parent process dies.

No child imports a module of the working directory: it may hold files of strangers, such as a
``typer.py`` in a repository that is checked. The parent kills a child that takes too long; a parent
that was killed cannot.
"""

__all__ = ["child_environment", "exit_with_parent", "python_command", "safe_multiprocessing"]

import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

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
    previous = os.environ.get(_SAFE_PATH_VARIABLE)
    os.environ[_SAFE_PATH_VARIABLE] = "1"
    try:
        yield
    finally:
        if previous is None:
            del os.environ[_SAFE_PATH_VARIABLE]
        else:
            os.environ[_SAFE_PATH_VARIABLE] = previous


def child_environment() -> dict[str, str]:
    """Return this process's environment variables for a child that calls `exit_with_parent`.

    A virtual environment's Python on Windows is a launcher: the child's parent is the launcher.
    """
    return os.environ | {_PARENT_VARIABLE: str(os.getpid())}


def exit_with_parent() -> None:
    """Start a thread that ends this process when its parent process has died."""
    watch = _watch_on_windows if os.name == "nt" else _watch_parent
    threading.Thread(target=watch, args=(os.getppid(),), name="lifeline", daemon=True).start()


def _watch_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_POLL_SECONDS)
    os._exit(1)  # a run of ONNX Runtime cannot be interrupted


def _watch_on_windows(parent: int) -> None:
    from gsgen.contract.process.windows import wait_for_exit

    wait_for_exit(int(os.environ.get(_PARENT_VARIABLE, parent)))
    os._exit(1)
