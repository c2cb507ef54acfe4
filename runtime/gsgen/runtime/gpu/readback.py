"""Reads several GPU buffers back through one permanent staging buffer."""

__all__ = ["Staging"]

from collections.abc import Iterable, Mapping
from typing import final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer, Encoder

_ALIGNMENT = 256


@final
class Staging:
    """A mappable GPU buffer with room for a copy of each named source buffer."""

    def __init__(self, device: Device, sources: Mapping[str, Buffer]) -> None:
        self._device, self._sources = device, dict(sources)
        self._offsets: dict[str, int] = {}
        size = 0
        for name, buffer in self._sources.items():
            self._offsets[name] = size
            size += -(-buffer.size // _ALIGNMENT) * _ALIGNMENT
        self._buffer = device.readable("staging", size)
        self._submission: int | None = None

    def encode(self, encoder: Encoder, names: Iterable[str] | None = None) -> None:
        """Encode the copy of the named source buffers, or of all, into the staging buffer."""
        for name in self._sources if names is None else names:
            source = self._sources[name]
            encoder.copy_buffer_to_buffer(source, 0, self._buffer, self._offsets[name], source.size)

    def begin(self) -> None:
        """Note that the last submission fills the buffer; :meth:`read` waits for no later one."""
        self._submission = self._device.submitted

    def read_words(self) -> dict[str, np.ndarray]:
        """Wait for the GPU, and return a copy of each source buffer as 32-bit words."""
        return self.read(dict.fromkeys(self._sources, np.uint32))

    def read(self, dtypes: Mapping[str, type[np.generic]]) -> dict[str, np.ndarray]:
        """Wait for the GPU, and return a copy of each named source buffer as an array."""
        submission = self._device.submitted if self._submission is None else self._submission
        self._submission = None
        with self._device.reading(self._buffer, submission) as memory:
            return {
                name: memory[self._offsets[name] :][: self._sources[name].size].view(dtype).copy()
                for name, dtype in dtypes.items()
            }
