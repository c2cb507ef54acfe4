"""Terminates a worker process when its parent process dies.

The parent kills a worker that takes too long; a parent that was killed cannot.
"""

__all__ = ["exit_with_parent"]

import os
import threading
import time

_EVERY_SECONDS = 0.5


def exit_with_parent() -> None:
    """Start a thread that ends this process when its parent process has died."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_EVERY_SECONDS)
        os._exit(1)  # a run of ONNX Runtime cannot be interrupted

    threading.Thread(target=watch, name="lifeline", daemon=True).start()
