"""Memory limits and waiting for processes on Windows, which lacks Python's ``resource``.

The structures and constants are those of the Windows API's job objects (``winnt.h``).
"""

__all__ = ["limit_commit", "wait_for_exit"]

import ctypes
from typing import Any, Final

_EXTENDED_LIMIT_INFORMATION: Final = 9
_LIMIT_PROCESS_MEMORY: Final = 0x100
_DIE_ON_UNHANDLED_EXCEPTION: Final = 0x400  # instead of a dialog that waits for a click
_SYNCHRONIZE_ACCESS_RIGHT: Final = 0x00100000
_INFINITE_TIMEOUT: Final = 0xFFFFFFFF


class _BasicLimits(ctypes.Structure):
    _fields_ = (
        ("PerProcessUserTimeLimit", ctypes.c_int64),
        ("PerJobUserTimeLimit", ctypes.c_int64),
        ("LimitFlags", ctypes.c_uint32),
        ("MinimumWorkingSetSize", ctypes.c_size_t),
        ("MaximumWorkingSetSize", ctypes.c_size_t),
        ("ActiveProcessLimit", ctypes.c_uint32),
        ("Affinity", ctypes.c_size_t),
        ("PriorityClass", ctypes.c_uint32),
        ("SchedulingClass", ctypes.c_uint32),
    )


class _ExtendedLimits(ctypes.Structure):
    _fields_ = (
        ("BasicLimitInformation", _BasicLimits),
        ("IoInfo", ctypes.c_uint64 * 6),
        ("ProcessMemoryLimit", ctypes.c_size_t),
        ("JobMemoryLimit", ctypes.c_size_t),
        ("PeakProcessMemoryUsed", ctypes.c_size_t),
        ("PeakJobMemoryUsed", ctypes.c_size_t),
    )


def limit_commit(limit: int) -> None:
    """Limit the memory that this process may allocate on Windows to ``limit`` bytes.

    The job is never closed: it lives as long as the process.

    Raises:
        OSError: Windows refuses the limit.
    """
    kernel32 = _kernel32()
    limits = _ExtendedLimits()
    limits.BasicLimitInformation.LimitFlags = _LIMIT_PROCESS_MEMORY | _DIE_ON_UNHANDLED_EXCEPTION
    limits.ProcessMemoryLimit = limit
    job = _require_handle(kernel32.CreateJobObjectW(None, None))
    size = ctypes.sizeof(limits)
    _require_handle(
        kernel32.SetInformationJobObject(
            job, _EXTENDED_LIMIT_INFORMATION, ctypes.byref(limits), size
        )
    )
    process = ctypes.c_void_p(kernel32.GetCurrentProcess())
    _require_handle(kernel32.AssignProcessToJobObject(job, process))


def wait_for_exit(process_id: int) -> None:
    """Wait until a process ends; return at once if it cannot be opened, since it has ended."""
    kernel32 = _kernel32()
    handle = kernel32.OpenProcess(_SYNCHRONIZE_ACCESS_RIGHT, False, process_id)
    if handle:
        kernel32.WaitForSingleObject(ctypes.c_void_p(handle), _INFINITE_TIMEOUT)


def _kernel32() -> Any:
    kernel32 = getattr(ctypes, "WinDLL")("kernel32", use_last_error=True)  # noqa: B009 (Windows only)
    for name in ("CreateJobObjectW", "GetCurrentProcess", "OpenProcess"):
        getattr(kernel32, name).restype = ctypes.c_void_p  # an int would cut the handle to 32 bits
    return kernel32


def _require_handle(result: int | None) -> ctypes.c_void_p:
    if not result:
        code = getattr(ctypes, "get_last_error")()  # noqa: B009
        raise OSError(f"Windows could not limit the memory of this process: error {code}")
    return ctypes.c_void_p(result)
