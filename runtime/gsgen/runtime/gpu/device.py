"""The graphics device: it creates labelled buffers and textures, and translates wgpu's errors."""

__all__ = ["MAPPED_ALIGNMENT", "MAX_WORKGROUPS", "MIN_MAPPED_BYTES", "Device"]

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Final, Self, final
from weakref import WeakSet

import numpy as np
from jaxtyping import Shaped

from gsgen.contract.errors import GsgenError
from gsgen.runtime.errors import CapacityExceeded, DeviceLost, DeviceUnavailable, MemoryFull
from gsgen.runtime.gpu.handles import (
    BindGroupLayout,
    Buffer,
    ComputePipeline,
    Encoder,
    RawDevice,
    RenderPipeline,
    Texture,
)
from gsgen.runtime.gpu.native import parse_native_types
from gsgen.runtime.gpu.sizes import symbolic_max

STORAGE_BUFFERS: Final = 8
"""Storage buffers that a kernel may bind on every WebGPU device."""

MAX_WORKGROUPS: Final = 65_535
"""Workgroups per dimension that every WebGPU device dispatches; larger indirect dispatches do
nothing."""

MIN_MAPPED_BYTES: Final = 1 << 20
"""Least size in bytes of buffers that are faster to map than to copy into."""

MAPPED_ALIGNMENT: Final = 8
"""Bytes of which every offset into a mapped buffer is a multiple."""

_SUBGROUP_FEATURE: Final = "subgroup"
_FLOAT_BLEND_FEATURE: Final = "float32-blendable"
_TIMESTAMP_FEATURE: Final = "timestamp-query"
_MAPPABLE_FEATURE: Final = "mappable-primary-buffers"
_INT64_FEATURE: Final = "shader-int64"
_RETRY_HINT = (
    "Try again; if that happens again, draw a smaller image or fewer Gaussians, or on another "
    "device: see `gsgen doctor`."
)
_MEMORY_HINT = "Draw fewer Gaussians or a smaller image, or close what else uses the device."
_DRIVER_HINT = (
    "Install a Vulkan driver; without a GPU, Mesa's lavapipe 25 or newer. See `gsgen doctor`."
)


@final
class Device:
    """A wgpu device with all features that the renderer's kernels need.

    Attributes:
        raw: The ``wgpu.GPUDevice``.
        name: Name of the adapter.
        software: Whether the driver runs on the CPU; workgroups are shaped differently then.
        largest_binding: Most bytes of one binding.
        largest_buffer: Most bytes of one buffer.
        largest_texture: Most pixels of a texture's side.
        subgroups: Whether shaders may use subgroup operations; no kernel requires them.
        blends_floats: Whether render pipelines can blend 32-bit floats.
        has_clock: Whether passes can write timestamps.
        maps: Whether this process can map the buffers that shaders read (host memory).
        wide: Whether shaders read and write 64 bits at a time.
        pipelines: Compute pipelines and their bind group layouts by shader text, entry point and
            types of bindings, which kernels share.
        render_pipelines: Render pipelines and their bind group layouts by shader text and what
            else makes them, which renderers share.
    """

    def __init__(self, raw: RawDevice) -> None:
        info = raw.adapter.info
        self.raw = raw
        self.name: str = info["device"]
        self.software: bool = info["adapter_type"] == "CPU"
        self.subgroups = _SUBGROUP_FEATURE in raw.features
        self.blends_floats = _FLOAT_BLEND_FEATURE in raw.features
        self.has_clock = _TIMESTAMP_FEATURE in raw.features
        self.maps_buffers = self.software and _MAPPABLE_FEATURE in raw.features
        self.has_int64 = self.software and _INT64_FEATURE in raw.features
        self.largest_buffer = int(raw.limits["max-buffer-size"])
        self.largest_binding = min(
            int(raw.limits["max-storage-buffer-binding-size"]), self.largest_buffer
        )
        self.largest_texture = int(raw.limits["max-texture-dimension-2d"])
        self.pipelines: dict[
            tuple[str, str, tuple[str, ...]], tuple[ComputePipeline, list[BindGroupLayout]]
        ] = {}
        self.render_pipelines: dict[tuple[str, str], tuple[RenderPipeline, BindGroupLayout]] = {}
        self._buffers: WeakSet[Buffer] = WeakSet()
        self._loss_probe = self.uniform("alive", 16)

    @classmethod
    def open(cls) -> Self:
        """Open the fastest adapter; the environment variable WGPUPY_WGPU_ADAPTER_NAME picks another.

        Raises:
            DeviceUnavailable: wgpu is not installed, or there is no usable adapter.
        """
        try:
            import wgpu
        except ImportError as error:
            raise DeviceUnavailable(
                "wgpu is not installed", hint="pip install 'gsgen[runtime]'"
            ) from error
        parse_native_types()
        try:
            adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
        except (RuntimeError, OSError, ValueError) as error:
            raise DeviceUnavailable(f"no graphics adapter: {error}", hint=_DRIVER_HINT) from error
        if adapter is None:
            raise DeviceUnavailable("no graphics adapter was found", hint=_DRIVER_HINT)
        limits = {
            name: adapter.limits[name]
            for name in ("max-storage-buffer-binding-size", "max-buffer-size")
        }
        limits["max-storage-buffers-per-shader-stage"] = STORAGE_BUFFERS
        features = {_SUBGROUP_FEATURE, _FLOAT_BLEND_FEATURE, _TIMESTAMP_FEATURE}
        if adapter.info["adapter_type"] == "CPU":  # a GPU would read mapped memory over its bus
            features |= {_MAPPABLE_FEATURE, _INT64_FEATURE}
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
                f"cannot open {adapter.info['device']}: {error}", hint=_DRIVER_HINT
            ) from error

    def storage(self, label: str, size: int, *, extra_usage: str = "") -> Buffer:
        """Return a new GPU storage buffer of ``size`` bytes, filled with zeros.

        Args:
            label: Name of the buffer in errors.
            size: Bytes, rounded up to whole vectors of 16 bytes, which kernels may read.
            extra_usage: Further wgpu usages, separated by ``|``.

        Raises:
            CapacityExceeded: No binding may be that large.
            MemoryFull: There is no memory for it.
        """
        if size > self.largest_binding:
            raise CapacityExceeded(
                f"would take {size:,} bytes; {self.name} binds at most {self.largest_binding:,}",
                where=label,
                hint="Draw fewer Gaussians or a smaller image.",
            )
        usage = "STORAGE|COPY_DST|COPY_SRC" + (f"|{extra_usage}" if extra_usage else "")
        return self._create_buffer(label, symbolic_max(-(-size // 16) * 16, 16), usage)

    def dynamic_storage(self, label: str, size: int) -> Buffer:
        """Return a new GPU storage buffer for data that changes often.

        Raises:
            CapacityExceeded: No binding may be that large.
            MemoryFull: There is no memory for it.
        """
        is_mapped = self.maps_buffers and size >= MIN_MAPPED_BYTES
        return self.storage(label, size, extra_usage="MAP_WRITE" if is_mapped else "")

    def can_map(self, buffer: Buffer) -> bool:
        """Return whether this process can map a GPU buffer for writing."""
        import wgpu

        return bool(buffer.usage & wgpu.BufferUsage.MAP_WRITE)

    def uniform(self, label: str, size: int) -> Buffer:
        """Return a new GPU uniform buffer of ``size`` bytes."""
        return self._create_buffer(label, -(-size // 16) * 16, "UNIFORM|COPY_DST")

    def readable(self, label: str, size: int) -> Buffer:
        """Return a new GPU buffer of ``size`` bytes for readback: the CPU can map and read it.

        Raises:
            CapacityExceeded: No buffer may be that large.
            MemoryFull: There is no memory for it.
        """
        return self._create_buffer(label, size, "MAP_READ|COPY_DST")

    def _create_buffer(self, label: str, size: int, usage: str) -> Buffer:
        import wgpu

        if size > self.largest_buffer:
            raise CapacityExceeded(
                f"would take {size:,} bytes; {self.name} has buffers of at most "
                f"{self.largest_buffer:,}",
                where=label,
                hint="Draw a smaller image, or ask for fewer outputs.",
            )
        try:
            buffer = self.raw.create_buffer(label=label, size=size, usage=usage)
        except wgpu.GPUOutOfMemoryError as error:
            allocated_bytes = sum(buffer.size for buffer in self._buffers)
            raise MemoryFull(
                f"needs {size:,} bytes, but the memory of {self.name} is full: buffers already "
                f"hold {allocated_bytes:,} bytes",
                where=label,
                hint=_MEMORY_HINT,
            ) from error
        self._buffers.add(buffer)
        return buffer

    def texture(self, label: str, size: tuple[int, int], format: str, usage: str) -> Texture:
        """Return a new GPU texture without mipmaps; ``format`` and ``usage`` are wgpu's names.

        Raises:
            CapacityExceeded: No texture may be that large.
        """
        width, height = size
        most = self.largest_texture
        if max(size) > most:
            raise CapacityExceeded(
                f"is {width}×{height}; {self.name} has textures of at most {most}×{most}",
                where=label,
                hint="Draw a smaller image, or use a smaller texture.",
            )
        return self.raw.create_texture(
            label=label, size=(width, height, 1), format=format, usage=usage
        )

    @property
    def is_lost(self) -> bool:
        """True if the graphics device was lost: even a write of 16 bytes fails.

        wgpu-py 0.32 does not implement ``lost_async``.
        """
        import wgpu

        try:
            self.write(self._loss_probe, np.zeros(4, np.float32))
        except wgpu.GPUError:
            return True
        return False

    @contextmanager
    def translate_errors(self) -> Iterator[None]:
        """Translate wgpu's errors in a ``with`` block to gsgen's errors.

        Raises:
            DeviceLost: The device was lost.
            MemoryFull: The device has no memory left.
        """
        import wgpu

        try:
            yield
        except wgpu.GPUOutOfMemoryError as error:
            raise MemoryFull(f"the memory of {self.name} is full", hint=_MEMORY_HINT) from error
        except GsgenError:
            raise
        except Exception as error:  # a lost device raises many types of errors in wgpu-py
            if not self.is_lost:
                raise
            raise self._device_lost_error() from error

    def submit(self, encoder: Encoder) -> None:
        """Submit the commands of an encoder to the GPU queue.

        Raises:
            DeviceLost: The device was lost; wgpu-native would end the process.
        """
        self.require()
        self.raw.queue.submit([encoder.finish()])

    def require(self) -> None:
        """Raise if the graphics device was lost, since some calls would end the process.

        Raises:
            DeviceLost: The device was lost.
        """
        if self.is_lost:
            raise self._device_lost_error()

    def _device_lost_error(self) -> DeviceLost:
        message = f"the graphics device was lost: {self.name}"
        return DeviceLost(message, hint=_RETRY_HINT)

    def write_mapped(
        self, buffer: Buffer, blocks: Iterable[Shaped[np.ndarray, "..."]], offset: int
    ) -> None:
        """Copy arrays one after the other into a GPU buffer, through memory that it maps.

        The buffer must satisfy :meth:`can_map`, and no submitted work may use it. ``offset`` and
        the bytes of each array but the last are multiples of MAPPED_ALIGNMENT.

        Raises:
            DeviceLost: The device was lost.
        """
        self.require()
        buffer.map_sync("WRITE")
        try:
            for block in blocks:
                buffer.write_mapped(block, offset)
                offset += block.nbytes
        finally:
            buffer.unmap()

    def write(self, buffer: Buffer, data: Shaped[np.ndarray, "..."], offset: int = 0) -> None:
        """Copy an array into a GPU buffer, padded to a multiple of four bytes."""
        raw = np.ascontiguousarray(data).reshape(-1).view(np.uint8)
        if raw.size % 4:
            raw = np.concatenate([raw, np.zeros(-raw.size % 4, np.uint8)])
        if raw.size:
            self.raw.queue.write_buffer(buffer, offset, raw)

    def read(self, buffer: Buffer, dtype: type[np.generic], count: int) -> np.ndarray:
        """Read the first ``count`` numbers of a GPU buffer, after all submitted work has ended."""
        size = count * np.dtype(dtype).itemsize
        if size == 0:
            return np.zeros(0, dtype)
        return np.frombuffer(self.raw.queue.read_buffer(buffer, 0, size), dtype)
