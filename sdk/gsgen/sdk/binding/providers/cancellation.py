"""What ends a computation that may never end by itself."""

__all__ = ["Stop"]

from typing import Any, Final, final

_FATAL: Final = 4  # what is less is in the error that is raised, and not printed besides


@final
class Stop:
    """Ends the runs of a session, from another thread than theirs.

    ONNX Runtime asks between two operators, those in a loop's body included; an operator that has
    begun is finished.
    """

    def __init__(self) -> None:
        self._options: list[Any] = []
        self._wanted = False

    def options(self) -> Any:
        """Return new options for runs that are to be ended."""
        import onnxruntime

        made = onnxruntime.RunOptions()
        made.log_severity_level = _FATAL
        made.terminate = self._wanted
        self._options.append(made)
        return made

    def now(self) -> None:
        """End what runs; what is run after fails at once, until :meth:`reset`."""
        self._set(True)

    def reset(self) -> None:
        """Let runs go on as if nothing had been said."""
        self._set(False)

    def _set(self, wanted: bool) -> None:
        self._wanted = wanted
        for one in self._options:
            one.terminate = wanted
