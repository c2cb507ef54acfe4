"""Buffers for the inputs and outputs of an ONNX Runtime session, on the host or a device."""

__all__ = ["Buffer", "DeviceBuffer", "HostBuffer", "make_buffer"]

import math
from abc import ABC, abstractmethod
from typing import Any, final

import numpy as np


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

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        import onnxruntime

        super().__init__(shape, dtype)
        self._array = np.zeros(shape, dtype)
        self._view = _read_only(self._array)
        self.value = onnxruntime.OrtValue.ortvalue_from_numpy(self._array)

    def write(self, array: np.ndarray) -> bool:
        """Copy an array into the tensor's host memory."""
        is_changed = not _same_bits(self._array, array)
        self._array[...] = array
        return is_changed

    def read(self) -> np.ndarray:
        """Return the tensor's host memory as an array, without a copy."""
        return self._view


@final
class DeviceBuffer(Buffer):
    """A tensor's buffer in device memory, with a fixed host array for copies both ways."""

    def __init__(
        self, session: Any, shape: tuple[int, ...], dtype: np.dtype[Any], memory: str
    ) -> None:
        import onnxruntime

        super().__init__(shape, dtype)
        self._array: np.ndarray | None = None
        self._written = False
        self._is_webgpu_memory = memory == "gpu"
        if self._is_webgpu_memory:  # such buffers belong to a session
            create_buffer = session.create_ortvalue_from_shape_and_type
        else:
            create_buffer = onnxruntime.OrtValue.ortvalue_from_shape_and_type
        self.value = create_buffer(list(shape), dtype.type, memory, 0)

    def write(self, array: np.ndarray) -> bool:
        """Copy an array to the tensor's device memory, unless that holds the same bits."""
        host = self._host_value()
        if self._written and _same_bits(host, array):
            return False
        host[...] = array
        self.value.update_inplace(host)
        self._written = True
        return True

    def read(self) -> np.ndarray:
        """Copy the tensor from device memory to the host, always into the same array."""
        import onnxruntime

        host = self._host_value()
        if self._is_webgpu_memory:
            onnxruntime.copy_tensors([self.value], [self._host_copy])
        else:  # copy_tensors does not support the built-in providers
            host[...] = self.value.numpy()
        return self._view

    def _host_value(self) -> np.ndarray:
        """Return the host array of a device buffer, which is allocated at its first use."""
        import onnxruntime

        if self._array is None:
            self._array = np.zeros(self.shape, self.dtype)
            self._view = _read_only(self._array)
            self._host_copy = onnxruntime.OrtValue.ortvalue_from_numpy(self._array)
        return self._array


def make_buffer(session: Any, shape: tuple[int, ...], dtype: np.dtype[Any], memory: str) -> Buffer:
    """Allocate the buffer of a tensor in the memory of the CPU, of WebGPU or of CUDA."""
    if memory == "cpu":
        return HostBuffer(shape, dtype)
    return DeviceBuffer(session, shape, dtype, memory)


def _same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.tobytes() == b.tobytes()  # so that -0 is not 0, and NaN is itself


def _read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view
