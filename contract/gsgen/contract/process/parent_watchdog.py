"""A child process ends when its parent has: nobody is left to stop it.

The parent kills a child that takes too long; a parent that was killed itself cannot.
"""

__all__ = ["exit_with_parent"]

import os
import threading
import time

_EVERY_SECONDS = 0.5


def exit_with_parent() -> None:
    """From now on, end this process at once when the process that started it is gone."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_EVERY_SECONDS)
        os._exit(1)  # ONNX Runtime may be in the middle of a run, which nothing interrupts

    threading.Thread(target=watch, name="lifeline", daemon=True).start()
