"""Reads several GPU buffers back through one permanent staging buffer."""

__all__ = ["StagingBuffers"]

from collections.abc import Iterable, Mapping
from typing import final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer, Encoder, Promise
from gsgen.runtime.gpu.native import map_for_reading

_BUFFER_ALIGNMENT = 256


@final
class StagingBuffers:
    """A mappable GPU buffer with room for a copy of each named source buffer."""

    def __init__(self, device: Device, sources: Mapping[str, Buffer]) -> None:
        self._device, self._source_buffers = device, dict(sources)
        self._buffer_offsets: dict[str, int] = {}
        size = 0
        for name, buffer in self._source_buffers.items():
            self._buffer_offsets[name] = size
            size += -(-buffer.size // _BUFFER_ALIGNMENT) * _BUFFER_ALIGNMENT
        self._staging_buffer = device.readable("staging", size)
        self._map_promise: Promise | None = None

    def encode(self, encoder: Encoder, names: Iterable[str] | None = None) -> None:
        """Encode the copy of the named source buffers, or of all, into the staging buffer."""
        if self._map_promise is not None:  # a frame that was never read, as after an interrupt
            self._map_promise.sync_wait()
            self._unmap_buffer()
        for name in self._source_buffers if names is None else names:
            source = self._source_buffers[name]
            encoder.copy_buffer_to_buffer(
                source, 0, self._staging_buffer, self._buffer_offsets[name], source.size
            )

    def begin(self) -> None:
        """Map the buffer once the work that was submitted so far has ended.

        :meth:`read` then waits for no later submission: wgpu waits for all work that it knows of
        when a mapping begins.
        """
        self._map_promise = map_for_reading(self._staging_buffer)

    def read_words(self) -> dict[str, np.ndarray]:
        """Wait for the GPU, and return a copy of each source buffer as 32-bit words."""
        return self.read(dict.fromkeys(self._source_buffers, np.uint32))

    def read(self, dtypes: Mapping[str, type[np.generic]]) -> dict[str, np.ndarray]:
        """Wait for the GPU, and return a copy of each named source buffer as an array.

        Raises:
            DeviceLost: The device was lost.
        """
        self._device.require()
        if self._map_promise is None:
            self.begin()
        assert self._map_promise is not None
        self._map_promise.sync_wait()
        try:
            memory = np.frombuffer(self._staging_buffer.read_mapped(copy=False), np.uint8)
            return {
                name: memory[self._buffer_offsets[name] :][: self._source_buffers[name].size]
                .view(dtype)
                .copy()
                for name, dtype in dtypes.items()
            }
        finally:
            self._unmap_buffer()

    def _unmap_buffer(self) -> None:
        self._staging_buffer.unmap()
        self._map_promise = None
