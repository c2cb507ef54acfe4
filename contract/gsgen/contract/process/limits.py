"""Limits on the time and memory of a worker process."""

__all__ = [
    "DRIVER_BYTES",
    "FRAME_SECONDS",
    "Limits",
    "available_cores",
    "inherited_memory_limit",
    "is_out_of_memory",
    "limit_memory",
    "limit_processor_time",
    "processor_seconds_of",
]

import math
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from gsgen.contract.errors import ConfigInvalid

FRAME_SECONDS: Final = 60.0
"""Time for loading a model that is drawn, and for each of its frames."""

DRIVER_BYTES: Final = 2 << 30
"""Memory for drivers and shader compilers, in addition to the model's."""

_MODEL_COPIES = 5
_DISK_RATIO = 4
_OUT_OF_MEMORY = (
    "bad_alloc",
    "bad allocation",
    "Failed to allocate memory",
    "Cannot allocate memory",  # for a thread's stack
    "MemoryError",
    "failed to map segment",  # of a library
    "can't start new thread",
    "pthread_create failed",
    "Unable to allocate",  # NumPy
    "std::system_error",  # a thread that cannot be started
)


@dataclass(frozen=True, slots=True)
class Limits:
    """The time and memory that a worker process may use.

    Attributes:
        seconds: Time for loading and all runs together, as an idle machine needs it: where other
            work takes the processor, time that passes without it does not count.
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

    @property
    def disk(self) -> int:
        """Bytes of files that a worker may write: all distinct outputs of its runs."""
        return _DISK_RATIO * self.memory

    def for_model(self, size: int) -> "Limits":
        """Return the process limits with memory added for loading ``size`` bytes of weights.

        ONNX Runtime holds the parsed file, its own copy, a folded copy, and the outputs.
        """
        return replace(self, memory=self.memory + _MODEL_COPIES * size)


def limit_memory(limit: int) -> None:
    """Limit the memory of this process to ``limit`` bytes, and disable core files.

    Linux counts the data segment, which includes private mappings; Windows counts committed
    memory. macOS accepts the limit and does not enforce it.
    """
    if os.name == "nt":
        from gsgen.contract.process.windows import limit_commit

        limit_commit(limit)
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _, hard_limit = resource.getrlimit(resource.RLIMIT_DATA)
    hard_limit = sys.maxsize if hard_limit == resource.RLIM_INFINITY else hard_limit
    resource.setrlimit(resource.RLIMIT_DATA, (min(limit, hard_limit), min(limit, hard_limit)))


def limit_processor_time(seconds: float) -> None:
    """Let this process use ``seconds`` more of processor time on each core, and then be killed.

    This ends a process that no parent watches any more. Windows has no such limit.
    """
    if os.name == "nt":
        return
    import resource
    import time

    limit = int(time.process_time() + seconds * available_cores()) + 1
    _, hard_limit = resource.getrlimit(resource.RLIMIT_CPU)
    if hard_limit == resource.RLIM_INFINITY or limit < hard_limit:
        resource.setrlimit(resource.RLIMIT_CPU, (limit, hard_limit))


def processor_seconds_of(pid: int) -> float:
    """Return the processor time of another process in seconds; infinity where it is not known."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()
    except OSError:  # no Linux, or the process has ended
        return math.inf
    user, system = fields[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def is_out_of_memory(error: Exception | str) -> bool:
    """Return whether an error, or the text of one, says that memory could not be allocated."""
    return isinstance(error, MemoryError) or any(text in str(error) for text in _OUT_OF_MEMORY)


def inherited_memory_limit() -> int:
    """Return the bytes that this process's own limits allow a child; the largest int without any."""
    if os.name == "nt":
        return sys.maxsize
    import resource

    data_limit = resource.getrlimit(resource.RLIMIT_DATA)[1]
    address_limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    finite = [size for size in (data_limit, address_limit) if size != resource.RLIM_INFINITY]
    return min(finite, default=sys.maxsize)


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux alone
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
