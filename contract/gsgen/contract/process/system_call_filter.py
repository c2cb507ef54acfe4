"""A filter of system calls (seccomp) that a Linux process sets for itself: no network, no programs.

Its program is one of the classic Berkeley packet filter: it loads fields of ``seccomp_data``, jumps
by their values, and returns what the kernel does. Constants are those of ``linux/seccomp.h`` and
``linux/audit.h``; the numbers of system calls, of the kernel's tables.
"""

__all__ = ["forbid_system_calls", "is_available"]

import ctypes
import errno
import os
import platform
import struct
import sys
from typing import Final

from gsgen.contract.process.landlock import forbid_new_privileges

_INSTRUCTION_STRUCT: Final = struct.Struct("=HBBI")
(
    _LOAD_INSTRUCTION,
    _JUMP_IF_EQUAL,
    _JUMP_IF_GREATER_EQUAL,
    _JUMP_IF_BITS_SET,
    _RETURN_INSTRUCTION,
) = 0x20, 0x15, 0x35, 0x45, 0x06
_ALLOW_SYSTEM_CALL, _KILL_PROCESS, _FAIL_SYSTEM_CALL = 0x7FFF0000, 0x80000000, 0x00050000
_NUMBER_OFFSET, _ARCHITECTURE_OFFSET, _FIRST_ARGUMENT_OFFSET = 0, 4, 16
_SET_FILTER_OPERATION, _ALL_THREADS_FLAG, _QUERY_ACTION = 1, 1, 2
_X32_CALL_BIT: Final = 0x40000000  # numbers of x86-64's second calling convention, x32
_CLONE_THREAD: Final = 0x10000

# Machine → its number of the architecture, and its numbers of system calls by name.
_ARCHITECTURES: Final = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
_SYSTEM_CALL_NUMBERS: Final[dict[str, dict[str, int]]] = {
    "x86_64": {
        "seccomp": 317, "clone": 56, "clone3": 435, "fork": 57, "vfork": 58, "execve": 59,
        "execveat": 322, "socket": 41, "connect": 42, "bind": 49, "listen": 50, "kill": 62,
        "ptrace": 101, "process_vm_readv": 310, "process_vm_writev": 311, "pidfd_open": 434,
        "pidfd_getfd": 438, "pidfd_send_signal": 424, "unshare": 272, "setns": 308, "mount": 165,
        "umount2": 166, "pivot_root": 155, "chroot": 161, "open_by_handle_at": 304, "bpf": 321,
        "perf_event_open": 298, "userfaultfd": 323, "io_uring_setup": 425, "add_key": 248,
        "request_key": 249, "keyctl": 250, "init_module": 175, "finit_module": 313,
        "kexec_load": 246,
    },
    "aarch64": {
        "seccomp": 277, "clone": 220, "clone3": 435, "execve": 221, "execveat": 281, "socket": 198,
        "connect": 203, "bind": 200, "listen": 201, "kill": 129, "ptrace": 117,
        "process_vm_readv": 270, "process_vm_writev": 271, "pidfd_open": 434, "pidfd_getfd": 438,
        "pidfd_send_signal": 424, "unshare": 97, "setns": 268, "mount": 40, "umount2": 39,
        "pivot_root": 41, "chroot": 51, "open_by_handle_at": 265, "bpf": 280,
        "perf_event_open": 241, "userfaultfd": 282, "io_uring_setup": 425, "add_key": 217,
        "request_key": 218, "keyctl": 219, "init_module": 105, "finit_module": 273,
        "kexec_load": 104,
    },
}  # fmt: skip
_CONDITIONAL_SYSTEM_CALLS: Final = frozenset({"seccomp", "clone", "clone3", "kill"})


def is_available() -> bool:
    """Return whether this kernel and processor can filter system calls by this module's program."""
    numbers = _SYSTEM_CALL_NUMBERS.get(platform.machine())
    if numbers is None or not sys.platform.startswith("linux"):
        return False
    action = ctypes.c_uint32(_FAIL_SYSTEM_CALL)
    libc = ctypes.CDLL(None, use_errno=True)
    return int(libc.syscall(numbers["seccomp"], _QUERY_ACTION, 0, ctypes.byref(action))) == 0


def forbid_system_calls() -> None:
    """Forbid this process network, other processes and programs, mounts and tracing.

    The calls fail with EPERM. Threads can be started; open sockets can be used.

    Raises:
        OSError: The kernel refuses it.
    """
    filter_program = b"".join(_filter_program(platform.machine()))
    forbid_new_privileges()
    count = len(filter_program) // _INSTRUCTION_STRUCT.size
    code = ctypes.create_string_buffer(filter_program, len(filter_program))
    header = struct.pack("@HP", count, ctypes.addressof(code))
    libc = ctypes.CDLL(None, use_errno=True)
    number = _SYSTEM_CALL_NUMBERS[platform.machine()]["seccomp"]
    result = libc.syscall(number, _SET_FILTER_OPERATION, _ALL_THREADS_FLAG, header)
    if result != 0:  # a positive number is a thread that has another filter
        raise OSError(ctypes.get_errno() or errno.EACCES, "the filter of system calls is refused")


def _filter_program(machine: str) -> list[bytes]:
    """Return the instructions of the filter for an architecture."""
    numbers = _SYSTEM_CALL_NUMBERS[machine]
    forbidden_numbers = [
        number for name, number in numbers.items() if name not in _CONDITIONAL_SYSTEM_CALLS
    ]
    permission = _FAIL_SYSTEM_CALL | errno.EPERM
    # A jump counts instructions from the next one: the last of each block skips nothing if taken.
    filter_program = [
        (_LOAD_INSTRUCTION, 0, 0, _ARCHITECTURE_OFFSET),
        (_JUMP_IF_EQUAL, 1, 0, _ARCHITECTURES[machine]),
        (_RETURN_INSTRUCTION, 0, 0, _KILL_PROCESS),
        (_LOAD_INSTRUCTION, 0, 0, _NUMBER_OFFSET),
        (_JUMP_IF_GREATER_EQUAL, 0, 1, _X32_CALL_BIT),
        (_RETURN_INSTRUCTION, 0, 0, permission),
        # The C library starts threads by clone3, whose flags a filter cannot read, or else by clone.
        (_JUMP_IF_EQUAL, 0, 1, numbers["clone3"]),
        (_RETURN_INSTRUCTION, 0, 0, _FAIL_SYSTEM_CALL | errno.ENOSYS),
        (_JUMP_IF_EQUAL, 0, 4, numbers["clone"]),
        (_LOAD_INSTRUCTION, 0, 0, _FIRST_ARGUMENT_OFFSET),
        (_JUMP_IF_BITS_SET, 0, 1, _CLONE_THREAD),
        (_RETURN_INSTRUCTION, 0, 0, _ALLOW_SYSTEM_CALL),
        (_RETURN_INSTRUCTION, 0, 0, permission),
        # A process may kill itself alone.
        (_JUMP_IF_EQUAL, 0, 4, numbers["kill"]),
        (_LOAD_INSTRUCTION, 0, 0, _FIRST_ARGUMENT_OFFSET),
        (_JUMP_IF_EQUAL, 0, 1, os.getpid()),
        (_RETURN_INSTRUCTION, 0, 0, _ALLOW_SYSTEM_CALL),
        (_RETURN_INSTRUCTION, 0, 0, permission),
        *(
            instruction
            for number in forbidden_numbers
            for instruction in (
                (_JUMP_IF_EQUAL, 0, 1, number),
                (_RETURN_INSTRUCTION, 0, 0, permission),
            )
        ),
        (_RETURN_INSTRUCTION, 0, 0, _ALLOW_SYSTEM_CALL),
    ]
    return [_INSTRUCTION_STRUCT.pack(*instruction) for instruction in filter_program]
