"""Limits on the time and memory of a worker process."""

__all__ = ["Limits", "limit_memory"]

import contextlib
import sys
from dataclasses import dataclass, replace

from gsgen.contract.errors import ConfigInvalid

_COPIES = 5


@dataclass(frozen=True, slots=True)
class Limits:
    """The time and memory that a worker process may use.

    Attributes:
        seconds: Wall-clock time for loading and all runs together.
        memory: Bytes of data (heap and private mappings).
    """

    seconds: float = 120.0
    memory: int = 2 << 30

    def __post_init__(self) -> None:
        if not (self.seconds > 0 and self.memory > 0):  # phrased so that NaN is refused
            actual = f"{self.seconds:g} s and {self.memory} bytes"
            raise ConfigInvalid(
                f"time and memory are {actual}, expected limits above 0", where="limits"
            )

    def for_model(self, size: int) -> "Limits":
        """Return these limits with memory added for loading ``size`` bytes of weights.

        ONNX Runtime holds the parsed file, its own copy, a folded copy, and the outputs.
        """
        return replace(self, memory=self.memory + _COPIES * size)


def limit_memory(limit: int) -> None:
    """Limit the data segment of this process to ``limit`` bytes, and disable core files."""
    with contextlib.suppress(ImportError):  # Windows has no such module
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        most = sys.maxsize if most == resource.RLIM_INFINITY else most
        resource.setrlimit(resource.RLIMIT_DATA, (min(limit, most), min(limit, most)))
