"""Why a child process ended: by a fault of the model that it ran, or of this machine."""

__all__ = ["ChildDeath", "classify_child_end", "memory_refused", "signal_name"]

import signal
from typing import Final, Literal, NamedTuple

from gsgen.contract.errors import HostProcessFailed
from gsgen.contract.process.limits import Limits, is_out_of_memory

# Signals that a process gets from its own faults; others come from the system or its users.
_CRASH_SIGNALS: Final = ("SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSEGV", "SIGSYS", "SIGTRAP")


class ChildDeath(NamedTuple):
    """Why a child process ended.

    Attributes:
        message: The reason, one line.
        stage: ``time``, ``memory``, ``crash``, or ``host`` for a fault of this machine.
    """

    message: str
    stage: Literal["time", "memory", "crash", "host"]


def classify_child_end(status: int, log: str, limits: Limits) -> ChildDeath:
    """Return why a child process ended by itself or by a signal that its parent did not send.

    Args:
        status: Exit status; negative for a signal.
        log: The text that it wrote to standard error.
        limits: The limits that it had.
    """
    name = signal_name(-status)
    last_line = (log.strip().splitlines() or ["no message"])[-1][:300]
    if status < 0 and name == "SIGXCPU":
        limit = f"{limits.seconds:g} s on each processor core"
        return ChildDeath(f"needs more processor time than {limit}", "time")
    if status < 0 and name not in _CRASH_SIGNALS:
        reason = "from outside, or by the system because memory ran out"
        return ChildDeath(f"killed by {name}, {reason}", "host")
    if is_out_of_memory(log):
        return ChildDeath(
            f"needs more than {limits.memory >> 20:,} MiB, the memory limit", "memory"
        )
    if status < 0:
        return ChildDeath(f"ended by signal {name}", "crash")
    return ChildDeath(f"exit status {status}: {last_line}", "crash")


def memory_refused(memory: int, host_limit: int, reason: str) -> HostProcessFailed:
    """Return the error of a process that gets less memory from this machine than it may take.

    Args:
        memory: Bytes that the process may take.
        host_limit: Bytes that this machine's limits leave it.
        reason: The allocation that failed.
    """
    return HostProcessFailed(
        f"the model may take {memory >> 20:,} MiB, but this process is limited to "
        f"{host_limit >> 20:,} MiB: {reason}",
        hint="Raise the limit (`ulimit -d`, `ulimit -v`), or give less --memory.",
    )


def signal_name(number: int) -> str:
    """Return the name of a signal, or its number if it has none."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return str(number)
