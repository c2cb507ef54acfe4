"""Cancels running inferences of an ONNX Runtime session from another thread."""

__all__ = ["Stop"]

from collections.abc import Callable
from typing import Any, Final, final

FATAL_LOG_LEVEL: Final = 4  # the log level; lesser messages are in the raised error and need no log


@final
class Stop:
    """Cancels running inferences of an ONNX Runtime session from another thread.

    ONNX Runtime checks for cancellation between two operators, including those in a loop's body;
    a running operator is finished.
    """

    def __init__(self) -> None:
        self._options: list[Any] = []
        self._callbacks: list[Callable[[], None]] = []
        self._terminate_flag = False

    def options(self) -> Any:
        """Return ONNX Runtime run options whose inference another thread can cancel."""
        import onnxruntime

        options = onnxruntime.RunOptions()
        options.log_severity_level = FATAL_LOG_LEVEL
        options.terminate = self._terminate_flag
        self._options.append(options)
        return options

    def call(self, callback: Callable[[], None]) -> None:
        """Call a function at each cancellation; at once if one has not been reset."""
        self._callbacks.append(callback)
        if self._terminate_flag:
            callback()

    @property
    def requested(self) -> bool:
        """Whether inferences are cancelled, since :meth:`now` and until :meth:`reset`."""
        return self._terminate_flag

    def now(self) -> None:
        """Cancel the running inferences of an ONNX Runtime session, until :meth:`reset`."""
        self._set_terminate_flag(terminate=True)
        for callback in self._callbacks:
            callback()

    def reset(self) -> None:
        """Allow an ONNX Runtime session to run inferences again after a cancellation."""
        self._set_terminate_flag(terminate=False)

    def _set_terminate_flag(self, *, terminate: bool) -> None:
        self._terminate_flag = terminate
        for options in self._options:
            options.terminate = terminate
