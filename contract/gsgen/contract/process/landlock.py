"""Landlock: a Linux process gives up files for itself and its children, without privileges.

The structures and constants are those of the kernel's ``linux/landlock.h``, up to version 6.
"""

__all__ = ["restrict_files", "version"]

import ctypes
import os
import struct
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Final

# System calls have these numbers on every architecture.
_CREATE_RULESET_SYSCALL, _ADD_RULE_SYSCALL, _RESTRICT_SELF_SYSCALL = 444, 445, 446
_QUERY_VERSION: Final = 1
_PATH_BENEATH_RULE_TYPE: Final = 1
_NO_NEW_PRIVILEGES: Final = 38  # an option of prctl
_PATH_RULE_STRUCT: Final = struct.Struct("=Qi")

_EXECUTE_FILE, _WRITE_FILE, _READ_FILE, _READ_DIRECTORY = 1 << 0, 1 << 1, 1 << 2, 1 << 3
_TRUNCATE_FILE, _DEVICE_CONTROL = 1 << 14, 1 << 15
_FILE_RIGHTS: Final = _EXECUTE_FILE | _WRITE_FILE | _READ_FILE | _TRUNCATE_FILE | _DEVICE_CONTROL
_READ_ACCESS: Final = _READ_FILE | _READ_DIRECTORY
# Version → all rights on files that it knows.
_FILE_RIGHTS_BY_VERSION: Final = {
    1: (1 << 13) - 1,
    2: (1 << 14) - 1,
    3: (1 << 15) - 1,
    5: (1 << 16) - 1,
}
_NETWORK_ACCESS_RIGHTS: Final = 0b11  # bind and connect of TCP, from version 4 on
_SOCKET_AND_SIGNAL_SCOPES: Final = 0b11  # abstract Unix sockets and signals, from version 6 on


def version() -> int:
    """Return the kernel's version of Landlock, or 0 if it has none."""
    if not sys.platform.startswith("linux"):
        return 0
    return max(0, int(_libc().syscall(_CREATE_RULESET_SYSCALL, None, 0, _QUERY_VERSION)))


def restrict_files(
    readable: Iterable[Path], writable: Iterable[Path], devices: Iterable[Path] = ()
) -> None:
    """Deny this process all files but some; also TCP, and signals to others, where the kernel can.

    The restriction holds for this thread and those that it starts, and for their children.

    Args:
        readable: Files, and folders with all they hold, that stay readable.
        writable: Files and folders that can also be written; files can be made there and removed.
        devices: Devices that are read, written and controlled.

    Raises:
        OSError: The kernel refuses it.
    """
    kernel_version = version()
    handled_rights = next(
        _FILE_RIGHTS_BY_VERSION[v]
        for v in sorted(_FILE_RIGHTS_BY_VERSION, reverse=True)
        if v <= kernel_version
    )
    fields = [handled_rights, _NETWORK_ACCESS_RIGHTS, _SOCKET_AND_SIGNAL_SCOPES]
    field_count = 3 if kernel_version >= 6 else 2 if kernel_version >= 4 else 1
    attributes = struct.pack(f"={field_count}Q", *fields[:field_count])
    ruleset = _call(_CREATE_RULESET_SYSCALL, attributes, len(attributes), 0)
    try:
        device_rights = _READ_ACCESS | _WRITE_FILE | _TRUNCATE_FILE | _DEVICE_CONTROL
        for paths, rights in (
            (readable, _READ_ACCESS),
            (writable, handled_rights & ~_EXECUTE_FILE & ~_DEVICE_CONTROL),
            (devices, device_rights & handled_rights),
        ):
            for path in paths:
                _allow_path(ruleset, path, rights)
        forbid_new_privileges()
        _call(_RESTRICT_SELF_SYSCALL, ruleset, 0)
    finally:
        os.close(ruleset)


def forbid_new_privileges() -> None:
    """Let no program that this process starts gain privileges, as the kernel demands."""
    if _libc().prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _allow_path(ruleset: int, path: Path, rights: int) -> None:
    """Add a rule for a path; do nothing if there is no such file."""
    try:
        descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        if not path.is_dir():
            rights &= _FILE_RIGHTS
        _call(
            _ADD_RULE_SYSCALL,
            ruleset,
            _PATH_BENEATH_RULE_TYPE,
            _PATH_RULE_STRUCT.pack(rights, descriptor),
            0,
        )
    finally:
        os.close(descriptor)


def _call(number: int, *arguments: int | bytes) -> int:
    result = int(_libc().syscall(number, *arguments))
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
