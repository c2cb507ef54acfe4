"""Terminates a worker process when its parent process dies.

The parent kills a worker that takes too long; a parent that was killed cannot.
"""

__all__ = ["child_environment", "exit_with_parent"]

import os
import threading
import time
from typing import Final

_POLL_SECONDS: Final = 0.5
_PARENT_VARIABLE: Final = "GSGEN_PARENT_PROCESS"


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
