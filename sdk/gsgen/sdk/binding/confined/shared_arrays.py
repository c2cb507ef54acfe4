"""Memory that a program and its confined child process share, and arrays in it."""

__all__ = ["SharedArraySlot", "SharedMemory", "create_memory_file"]

import math
import mmap
import os
import tempfile
from typing import Any, Final, NamedTuple, final

import numpy as np

from gsgen.contract.errors import HostProcessFailed
from gsgen.sdk.binding.providers.buffers import HostMemory
from gsgen.sdk.binding.providers.errors import RunFailed

_ALIGNMENT: Final = 4096  # bytes; a page, which is more than any kernel needs


class SharedArraySlot(NamedTuple):
    """Where an array lies in shared memory: its first byte, shape and dtype."""

    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]


def create_memory_file(size: int) -> int:
    """Return the descriptor of a file of ``size`` zero bytes, which take memory once written.

    On Linux it is in memory, and its size stays: a process that reads beyond the end of a file is
    killed. Elsewhere it is a temporary file.

    Raises:
        HostProcessFailed: The system refuses it.
    """
    try:
        if hasattr(os, "memfd_create"):  # Linux alone
            import fcntl  # not on Windows, where this module is imported

            file = os.memfd_create("gsgen", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
            os.ftruncate(file, size)
            memory_seals = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL
            fcntl.fcntl(file, fcntl.F_ADD_SEALS, memory_seals)
            return file
        with tempfile.TemporaryFile(prefix="gsgen-") as temporary_file:
            temporary_file.truncate(size)
            return os.dup(temporary_file.fileno())
    except OSError as error:
        raise HostProcessFailed(f"no memory to share with a model: {error.strerror}") from error


@final
class SharedMemory(HostMemory):
    """Arrays in a file that several processes map.

    Args:
        file: Descriptor of the file, which is closed.
    """

    def __init__(self, file: int) -> None:
        try:
            self._size = os.fstat(file).st_size
            self._map = mmap.mmap(file, self._size)
        except OSError as error:
            raise HostProcessFailed(f"no memory to share with a model: {error.strerror}") from error
        finally:
            os.close(file)
        self._bytes = np.frombuffer(self._map, np.uint8)
        self._end_offset = 0

    def array(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> np.ndarray:
        """Return a new array of zeros in the shared memory.

        Raises:
            RunFailed: The shared memory has no room for it.
        """
        size = math.prod(shape) * dtype.itemsize
        array_slot = SharedArraySlot(self._end_offset, shape, dtype)
        if not 0 <= size <= self._size - self._end_offset:
            limit = f"the {(self._size - self._end_offset) >> 20:,} MiB left of the memory limit (--memory)"
            taken_text = f"a tensor of shape {list(shape)} takes {size / 1e9:.1f} GB"
            raise RunFailed(f"{taken_text}, more than {limit}")
        self._end_offset += -(-size // _ALIGNMENT) * _ALIGNMENT
        result = self.array_at(array_slot)
        result[...] = np.zeros((), dtype)
        return result

    def clear(self) -> None:
        """Give the places of all arrays to the next ones."""
        self._end_offset = 0

    def place_of(self, array: np.ndarray) -> SharedArraySlot:
        """Return where an array of :meth:`array` lies."""
        start = self._bytes.__array_interface__["data"][0]
        return SharedArraySlot(
            array.__array_interface__["data"][0] - start, array.shape, array.dtype
        )

    def array_at(self, array_slot: SharedArraySlot) -> np.ndarray:
        """Return the array at a place that another process names.

        Raises:
            RunFailed: The place is outside of the memory.
        """
        offset, shape, dtype = array_slot
        size = math.prod(shape) * dtype.itemsize
        if min(offset, *shape, 0) < 0 or size > self._size - offset or dtype.hasobject:
            raise RunFailed(f"an array of shape {list(shape)} is outside of the shared memory")
        return self._bytes[offset : offset + size].view(dtype).reshape(shape)
