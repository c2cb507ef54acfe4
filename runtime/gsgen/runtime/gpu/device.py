"""The graphics device: opened once, shared by all that draws, with buffers that have names."""

__all__ = ["MAPPED_FROM", "MOST_GROUPS", "Device"]

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, Self, final
from weakref import WeakSet

import numpy as np
from jaxtyping import Shaped, UInt8

from gsgen.contract.errors import GsgenError
from gsgen.runtime.errors import CapacityExceeded, DeviceLost, DeviceUnavailable, MemoryFull

STORAGE_BUFFERS: Final = 8
"""How many storage buffers a kernel may bind: what every WebGPU device has."""

MOST_GROUPS: Final = 65_535
"""Workgroups that every WebGPU device dispatches in one dimension; more by a count are none."""

MAPPED_FROM: Final = 1 << 20
"""Bytes from which on mapping a buffer takes less than the copies that it saves."""

_SUBGROUPS: Final = "subgroup"
_BLENDING: Final = "float32-blendable"
_CLOCK: Final = "timestamp-query"
_MAPPED: Final = "mappable-primary-buffers"
_AGAIN = (
    "Try again; if that happens again, draw a smaller image or fewer Gaussians, or on another "
    "device: see `gsgen doctor`."
)
_LESS = "Draw fewer Gaussians or a smaller image, or close what else uses the device."
_MEND = "Install a Vulkan driver; without a GPU, Mesa's lavapipe 25 or newer. See `gsgen doctor`."


@final
class Device:
    """A wgpu device that can run the kernels.

    Attributes:
        raw: The ``wgpu.GPUDevice``.
        name: What the adapter calls itself.
        software: Whether the driver runs on the CPU; kernels are cut differently then.
        largest_binding: Bytes that one binding may have.
        largest_buffer: Bytes that one buffer may have.
        largest_texture: Pixels that a texture may have, a side.
        subgroups: Whether shaders may use operations of subgroups; none has to.
        blends_floats: Whether its rasteriser can blend 32-bit floats.
        has_clock: Whether it can say when a pass begins and ends.
        maps: Whether this process writes to where shaders read: its memory is the host's.
    """

    def __init__(self, raw: Any) -> None:
        info = raw.adapter.info
        self.raw = raw
        self.name: str = info["device"]
        self.software: bool = info["adapter_type"] == "CPU"
        self.subgroups = _SUBGROUPS in raw.features
        self.blends_floats = _BLENDING in raw.features
        self.has_clock = _CLOCK in raw.features
        self.maps = self.software and _MAPPED in raw.features
        self.largest_buffer = int(raw.limits["max-buffer-size"])
        self.largest_binding = min(
            int(raw.limits["max-storage-buffer-binding-size"]), self.largest_buffer
        )
        self.largest_texture = int(raw.limits["max-texture-dimension-2d"])
        self._buffers: WeakSet[Any] = WeakSet()
        self._alive = self.uniform("alive", 16)

    @classmethod
    def open(cls) -> Self:
        """Open the fastest adapter; the environment variable WGPUPY_WGPU_ADAPTER_NAME picks another.

        Raises:
            DeviceUnavailable: wgpu is not installed, no adapter is there, or it refuses.
        """
        try:
            import wgpu
        except ImportError as error:
            raise DeviceUnavailable(
                "wgpu is not installed", hint="pip install 'gsgen[runtime]'"
            ) from error
        try:
            adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
        except (RuntimeError, OSError, ValueError) as error:
            raise DeviceUnavailable(f"no graphics adapter: {error}", hint=_MEND) from error
        if adapter is None:
            raise DeviceUnavailable("no graphics adapter", hint=_MEND)
        limits = {
            name: adapter.limits[name]
            for name in ("max-storage-buffer-binding-size", "max-buffer-size")
        }
        limits["max-storage-buffers-per-shader-stage"] = STORAGE_BUFFERS
        features = {_SUBGROUPS, _BLENDING, _CLOCK}
        if adapter.info["adapter_type"] == "CPU":  # a card would read it over its bus
            features.add(_MAPPED)
        try:
            return cls(
                adapter.request_device_sync(
                    label="gsgen",
                    required_limits=limits,
                    required_features=sorted(features & set(adapter.features)),
                )
            )
        except (RuntimeError, wgpu.GPUError) as error:
            raise DeviceUnavailable(
                f"{adapter.info['device']} refuses: {error}", hint=_MEND
            ) from error

    def storage(self, label: str, size: int, *, extra: str = "") -> Any:
        """Return a new storage buffer of ``size`` bytes, which is zero.

        Args:
            label: What it holds; errors name it.
            size: Rounded up to whole words of 16 bytes, which kernels may read it by.
            extra: More usages, as wgpu spells them.

        Raises:
            CapacityExceeded: No binding may be that large.
            MemoryFull: There is no memory for it.
        """
        if size > self.largest_binding:
            raise CapacityExceeded(
                f"would take {size:,} bytes; {self.name} binds {self.largest_binding:,} at most",
                where=label,
                hint="Draw fewer Gaussians or a smaller image.",
            )
        usage = "STORAGE|COPY_DST|COPY_SRC" + (f"|{extra}" if extra else "")
        return self._buffer(label, max(16, -(-size // 16) * 16), usage)

    def filled(self, label: str, size: int) -> Any:
        """Return a new storage buffer that is written often, and much at a time.

        Raises:
            CapacityExceeded: No binding may be that large.
            MemoryFull: There is no memory for it.
        """
        mapped = self.maps and size >= MAPPED_FROM
        return self.storage(label, size, extra="MAP_WRITE" if mapped else "")

    def can_map(self, buffer: Any) -> bool:
        """Say whether this process can write to a buffer's own memory: to a large ``filled`` one."""
        import wgpu

        return bool(buffer.usage & wgpu.BufferUsage.MAP_WRITE)

    def uniform(self, label: str, size: int) -> Any:
        """Return a new uniform buffer of ``size`` bytes."""
        return self._buffer(label, -(-size // 16) * 16, "UNIFORM|COPY_DST")

    def readable(self, label: str, size: int) -> Any:
        """Return a new buffer of ``size`` bytes that this process can read.

        Raises:
            CapacityExceeded: No buffer may be that large.
            MemoryFull: There is no memory for it.
        """
        return self._buffer(label, size, "MAP_READ|COPY_DST")

    def _buffer(self, label: str, size: int, usage: str) -> Any:
        import wgpu

        if size > self.largest_buffer:
            raise CapacityExceeded(
                f"would take {size:,} bytes; {self.name} has buffers of {self.largest_buffer:,} "
                "at most",
                where=label,
                hint="Draw a smaller image, or ask for fewer outputs.",
            )
        try:
            made = self.raw.create_buffer(label=label, size=size, usage=usage)
        except wgpu.GPUOutOfMemoryError as error:
            held = sum(buffer.size for buffer in self._buffers)
            raise MemoryFull(
                f"needs {size:,} bytes, and the memory of {self.name} is full: buffers hold "
                f"{held:,} bytes already",
                where=label,
                hint=_LESS,
            ) from error
        self._buffers.add(made)
        return made

    def texture(self, label: str, size: tuple[int, int], format: str, usage: str) -> Any:
        """Return a new texture of one level.

        Args:
            label: What it holds; errors name it.
            size: Width and height, in pixels.
            format: Of a pixel, as wgpu spells it.
            usage: As wgpu spells it.

        Raises:
            CapacityExceeded: No texture may be that large.
        """
        width, height = size
        most = self.largest_texture
        if max(size) > most:
            raise CapacityExceeded(
                f"is {width}×{height}; {self.name} has textures of {most}×{most} at most",
                where=label,
                hint="Make it smaller.",
            )
        return self.raw.create_texture(
            label=label, size=(width, height, 1), format=format, usage=usage
        )

    @property
    def lost(self) -> bool:
        """Whether the device went away: it refuses what no device refuses.

        wgpu-py 0.32 has no promise of a loss (``lost_async`` is not implemented).
        """
        import wgpu

        try:
            self.write(self._alive, np.zeros(4, np.float32))
        except wgpu.GPUError:
            return True
        return False

    @contextmanager
    def translate_errors(self) -> Iterator[None]:
        """Say in our words what the device refuses in the block.

        Raises:
            DeviceLost: It went away.
            MemoryFull: It has no memory left.
        """
        import wgpu

        try:
            yield
        except wgpu.GPUOutOfMemoryError as error:
            raise MemoryFull(f"the memory of {self.name} is full", hint=_LESS) from error
        except GsgenError:
            raise
        except Exception as error:  # wgpu-py stumbles over a lost device in several ways
            if not self.lost:
                raise
            raise self._gone() from error

    def submit(self, encoder: Any) -> None:
        """Let the device do what an encoder has recorded.

        Raises:
            DeviceLost: It went away; wgpu-native would end the process.
        """
        self.require()
        self.raw.queue.submit([encoder.finish()])

    def require(self) -> None:
        """Make sure that the device is there, before what would end the process without it.

        Raises:
            DeviceLost: It went away.
        """
        if self.lost:
            raise self._gone()

    def _gone(self) -> DeviceLost:
        what = f"the graphics device was lost: {self.name}"
        return DeviceLost(what, hint=_AGAIN)

    @contextmanager
    def mapped(
        self, buffer: Any, offset: int, size: int
    ) -> Iterator[UInt8[np.ndarray, " n"]]:
        """Yield the memory of a buffer, to be written.

        Args:
            buffer: One that it ``can_map``, and is not at work with.
            offset: The first byte.
            size: How many.

        Raises:
            DeviceLost: It went away.
        """
        from wgpu.backends.wgpu_native import ffi, lib

        self.require()
        buffer.map_sync("WRITE")
        try:
            first = lib.wgpuBufferGetMappedRange(buffer._internal, 0, buffer.size)
            memory = np.frombuffer(ffi.buffer(first, buffer.size), np.uint8)
            yield memory[offset : offset + size]
        finally:
            buffer.unmap()

    def write(self, buffer: Any, data: Shaped[np.ndarray, "..."], offset: int = 0) -> None:
        """Copy an array into a buffer; odd halves are filled up to a whole word."""
        raw = np.ascontiguousarray(data).reshape(-1).view(np.uint8)
        if raw.size % 4:
            raw = np.concatenate([raw, np.zeros(-raw.size % 4, np.uint8)])
        if raw.size:
            self.raw.queue.write_buffer(buffer, offset, raw)

    def read(self, buffer: Any, dtype: type[np.generic], count: int) -> np.ndarray:
        """Return the first ``count`` numbers of a buffer, once the device has made them."""
        size = count * np.dtype(dtype).itemsize
        if size == 0:
            return np.zeros(0, dtype)
        return np.frombuffer(self.raw.queue.read_buffer(buffer, 0, size), dtype)
