"""Devices with the limits of others: little memory, small bindings, or gone during a film."""

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch
from weakref import WeakSet

from gsgen.runtime.gpu.device import Device


@contextmanager
def memory_of(size: int) -> Iterator[None]:
    """Let no device have more than ``size`` bytes of buffers, besides those that it has.

    No software driver runs out of memory before the machine does; this one says so as wgpu does.
    """
    import wgpu

    make, result, most = Device._create_buffer, WeakSet[Any](), size

    def limited(self: Device, *words: Any) -> Any:
        raw = self.raw

        def create_buffer(*, size: int, **words: Any) -> Any:
            if sum(buffer.size for buffer in result) + size > most:
                raise wgpu.GPUOutOfMemoryError("Not enough memory left.")
            result.add(buffer := raw.create_buffer(size=size, **words))
            return buffer

        self.raw = SimpleNamespace(create_buffer=create_buffer)
        try:
            return make(self, *words)
        finally:
            self.raw = raw

    with patch.object(Device, "_create_buffer", limited):
        yield


@contextmanager
def bindings_of(size: int) -> Iterator[None]:
    """Let devices bind at most ``size`` bytes at once."""
    begin = Device.__init__

    def limited(self: Device, raw: Any) -> None:
        begin(self, raw)
        self.largest_binding = size

    with patch.object(Device, "__init__", limited):
        yield


@contextmanager
def lost_at(frame: int) -> Iterator[None]:
    """Take devices away before they draw their n-th frame, from 0."""
    submit, drawn = Device.submit, 0

    def counted(self: Device, encoder: Any) -> None:
        nonlocal drawn
        if encoder.label == "frame":
            if drawn == frame:
                self.raw.destroy()
            drawn += 1
        submit(self, encoder)

    with patch.object(Device, "submit", counted):
        yield
