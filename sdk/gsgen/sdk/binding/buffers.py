"""Memory that a session's inputs and outputs stay in, on the host or on a device."""

__all__ = ["Buffer", "DeviceBuffer", "HostBuffer", "make_buffer"]

import math
from abc import ABC, abstractmethod
from typing import Any, final

import numpy as np


class Buffer(ABC):
    """One tensor that is bound once.

    Attributes:
        value: ONNX Runtime's handle, which says where the memory is.
        shape: Its size along each axis.
        dtype: Its dtype.
    """

    value: Any

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.shape, self.dtype = shape, dtype

    @property
    def nbytes(self) -> int:
        """Its size in bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    @abstractmethod
    def write(self, array: np.ndarray) -> bool:
        """Copy ``array``, of the same shape and dtype, into the memory.

        Returns:
            Whether the memory held other bits before.
        """

    @abstractmethod
    def read(self) -> np.ndarray:
        """Return what is in the memory, read-only; a later call may reuse the array."""


@final
class HostBuffer(Buffer):
    """Memory of the host, which ONNX Runtime reads and writes in place: nothing is copied."""

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        import onnxruntime

        super().__init__(shape, dtype)
        self._array = np.zeros(shape, dtype)
        self._shown = _read_only(self._array)
        self.value = onnxruntime.OrtValue.ortvalue_from_numpy(self._array)

    def write(self, array: np.ndarray) -> bool:
        """Copy ``array`` into the memory."""
        changed = not _same_bits(self._array, array)
        self._array[...] = array
        return changed

    def read(self) -> np.ndarray:
        """Return a view of the memory."""
        return self._shown


@final
class DeviceBuffer(Buffer):
    """Memory of a device, and a stable place on the host that it is copied from or to."""

    def __init__(
        self, session: Any, shape: tuple[int, ...], dtype: np.dtype[Any], memory: str
    ) -> None:
        import onnxruntime

        super().__init__(shape, dtype)
        self._array: np.ndarray | None = None
        self._written = False
        self._of_webgpu = memory == "gpu"
        if self._of_webgpu:  # such buffers belong to a session
            make = session.create_ortvalue_from_shape_and_type
        else:
            make = onnxruntime.OrtValue.ortvalue_from_shape_and_type
        self.value = make(list(shape), dtype.type, memory, 0)

    def write(self, array: np.ndarray) -> bool:
        """Copy ``array`` to the device, unless it is there."""
        host = self._host()
        if self._written and _same_bits(host, array):
            return False
        host[...] = array
        self.value.update_inplace(host)
        self._written = True
        return True

    def read(self) -> np.ndarray:
        """Copy the memory to the host, always to the same place."""
        import onnxruntime

        host = self._host()
        if self._of_webgpu:
            onnxruntime.copy_tensors([self.value], [self._mirror])
        else:  # built-in providers bring no transfer that copy_tensors knows
            host[...] = self.value.numpy()
        return self._shown

    def _host(self) -> np.ndarray:
        """Return the place on the host, which is made when it is first needed."""
        import onnxruntime

        if self._array is None:
            self._array = np.zeros(self.shape, self.dtype)
            self._shown = _read_only(self._array)
            self._mirror = onnxruntime.OrtValue.ortvalue_from_numpy(self._array)
        return self._array


def make_buffer(
    session: Any, shape: tuple[int, ...], dtype: np.dtype[Any], memory: str
) -> Buffer:
    """Return a buffer in ``memory``: ``cpu``, ``gpu`` (WebGPU) or ``cuda``."""
    if memory == "cpu":
        return HostBuffer(shape, dtype)
    return DeviceBuffer(session, shape, dtype, memory)


def _same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.tobytes() == b.tobytes()  # so that -0 is not 0, and NaN is itself


def _read_only(array: np.ndarray) -> np.ndarray:
    shown = array.view()
    shown.flags.writeable = False
    return shown
