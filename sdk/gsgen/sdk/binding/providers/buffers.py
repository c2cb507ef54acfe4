"""Buffers for the inputs and outputs of an ONNX Runtime session, on the host or a device."""

__all__ = [
    "Buffer",
    "DeviceBuffer",
    "HostBuffer",
    "HostMemory",
    "make_buffer",
    "read_only",
    "same_bits",
]

import math
from abc import ABC, abstractmethod
from typing import Any, final

import numpy as np


class HostMemory:
    """Allocates the host arrays of a session's tensors, in the memory of this process."""

    def array(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> np.ndarray:
        """Return a new array of zeros."""
        return np.zeros(shape, dtype)

    def clear(self) -> None:
        """Free all arrays, before the tensors of another session are allocated."""


class Buffer(ABC):
    """The memory of one tensor, which is bound once to an ONNX Runtime session.

    Attributes:
        value: ONNX Runtime's handle of the memory.
        shape: Size along each axis.
        dtype: The tensor's dtype.
    """

    value: Any

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.shape, self.dtype = shape, dtype

    @property
    def nbytes(self) -> int:
        """The size of the tensor's buffer in bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    @abstractmethod
    def host(self) -> np.ndarray:
        """The tensor's array in host memory, always the same one."""

    @abstractmethod
    def upload(self) -> None:
        """Copy the array in host memory to the device, if the tensor's buffer is there."""

    @abstractmethod
    def write(self, array: np.ndarray) -> bool:
        """Copy an array of the tensor's shape and dtype into the tensor's buffer.

        Returns:
            Whether any bit of the memory changed.
        """

    @abstractmethod
    def read(self) -> np.ndarray:
        """Return the content of the tensor's buffer, read-only; later calls may reuse the array."""


@final
class HostBuffer(Buffer):
    """A tensor's buffer in host memory, which ONNX Runtime reads and writes without copies."""

    def __init__(
        self, shape: tuple[int, ...], dtype: np.dtype[Any], host_memory: HostMemory
    ) -> None:
        import onnxruntime

        super().__init__(shape, dtype)
        self._array = host_memory.array(shape, dtype)
        self._view = read_only(self._array)
        self.value = onnxruntime.OrtValue.ortvalue_from_numpy(self._array)

    @property
    def host(self) -> np.ndarray:
        """The tensor's buffer itself."""
        return self._array

    def upload(self) -> None:
        """Do nothing: the tensor's buffer is in host memory."""

    def write(self, array: np.ndarray) -> bool:
        """Copy an array into the tensor's host memory."""
        is_input_changed = not same_bits(self._array, array)
        self._array[...] = array
        return is_input_changed

    def read(self) -> np.ndarray:
        """Return the tensor's host memory as an array, without a copy."""
        return self._view


@final
class DeviceBuffer(Buffer):
    """A tensor's buffer in device memory, with a fixed host array for copies both ways."""

    def __init__(
        self,
        session: Any,
        shape: tuple[int, ...],
        dtype: np.dtype[Any],
        memory: str,
        host_memory: HostMemory,
    ) -> None:
        import onnxruntime

        super().__init__(shape, dtype)
        self._host_memory = host_memory
        self._array: np.ndarray | None = None
        self._is_written = False
        self._is_webgpu_memory = memory == "gpu"
        if self._is_webgpu_memory:  # such buffers belong to a session
            create_buffer = session.create_ortvalue_from_shape_and_type
        else:
            create_buffer = onnxruntime.OrtValue.ortvalue_from_shape_and_type
        self.value = create_buffer(list(shape), dtype.type, memory, 0)

    def write(self, array: np.ndarray) -> bool:
        """Copy an array to the tensor's device memory, unless that holds the same bits."""
        host = self.host
        if self._is_written and same_bits(host, array):
            return False
        host[...] = array
        self.upload()
        return True

    def upload(self) -> None:
        """Copy the tensor's array in host memory to the device."""
        self.value.update_inplace(self.host)
        self._is_written = True

    def read(self) -> np.ndarray:
        """Copy the tensor from device memory to the host, always into the same array."""
        import onnxruntime

        host = self.host
        if self._is_webgpu_memory:
            onnxruntime.copy_tensors([self.value], [self._host_copy])
        else:  # copy_tensors does not support the built-in providers
            host[...] = self.value.numpy()
        return self._view

    @property
    def host(self) -> np.ndarray:
        """The host array of a device buffer, which is allocated at its first use."""
        import onnxruntime

        if self._array is None:
            self._array = self._host_memory.array(self.shape, self.dtype)
            self._view = read_only(self._array)
            self._host_copy = onnxruntime.OrtValue.ortvalue_from_numpy(self._array)
        return self._array


def make_buffer(
    session: Any, shape: tuple[int, ...], dtype: np.dtype[Any], memory: str, host_memory: HostMemory
) -> Buffer:
    """Allocate the buffer of a tensor in the memory of the CPU, of WebGPU or of CUDA."""
    if memory == "cpu":
        return HostBuffer(shape, dtype, host_memory)
    return DeviceBuffer(session, shape, dtype, memory, host_memory)


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether two arrays of one shape and dtype have the same bits."""
    return a.tobytes() == b.tobytes()  # so that -0 is not 0, and NaN is itself


def read_only(array: np.ndarray) -> np.ndarray:
    """Return a view of an array that cannot be written through."""
    view = array.view()
    view.flags.writeable = False
    return view
