"""The graphics device: opened once, shared by all that draws, with buffers that have names."""

__all__ = ["Device"]

from typing import Any, Final, Self, final

import numpy as np
from jaxtyping import Shaped

from gsgen.runtime.errors import CapacityExceeded, DeviceUnavailable

STORAGE_BUFFERS: Final = 8
"""How many storage buffers a kernel may bind: what every WebGPU device has."""

_SUBGROUPS: Final = "subgroup"
_BLENDING: Final = "float32-blendable"
_CLOCK: Final = "timestamp-query"
_MEND = "Install a Vulkan driver; without a GPU, Mesa's lavapipe 25 or newer. See `gsgen doctor`."


@final
class Device:
    """A wgpu device that can run the kernels.

    Attributes:
        raw: The ``wgpu.GPUDevice``.
        name: What the adapter calls itself.
        software: Whether the driver runs on the CPU; kernels are cut differently then.
        largest_binding: Bytes that one binding may have.
        subgroups: Whether shaders may use operations of subgroups; none has to.
        blends_floats: Whether its rasteriser can blend 32-bit floats.
        has_clock: Whether it can say when a pass begins and ends.
    """

    def __init__(self, raw: Any) -> None:
        info = raw.adapter.info
        self.raw = raw
        self.name: str = info["device"]
        self.software: bool = info["adapter_type"] == "CPU"
        self.subgroups = _SUBGROUPS in raw.features
        self.blends_floats = _BLENDING in raw.features
        self.has_clock = _CLOCK in raw.features
        self.largest_binding = min(
            int(raw.limits["max-storage-buffer-binding-size"]),
            int(raw.limits["max-buffer-size"]),
        )

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
                "wgpu is not installed", mend="pip install 'gsgen[runtime]'"
            ) from error
        try:
            adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
        except (RuntimeError, OSError, ValueError) as error:
            raise DeviceUnavailable(f"no graphics adapter: {error}", mend=_MEND) from error
        if adapter is None:
            raise DeviceUnavailable("no graphics adapter", mend=_MEND)
        limits = {
            name: adapter.limits[name]
            for name in ("max-storage-buffer-binding-size", "max-buffer-size")
        }
        limits["max-storage-buffers-per-shader-stage"] = STORAGE_BUFFERS
        try:
            return cls(
                adapter.request_device_sync(
                    label="gsgen",
                    required_limits=limits,
                    required_features=sorted(
                        {_SUBGROUPS, _BLENDING, _CLOCK} & set(adapter.features)
                    ),
                )
            )
        except (RuntimeError, wgpu.GPUError) as error:
            raise DeviceUnavailable(
                f"{adapter.info['device']} refuses: {error}", mend=_MEND
            ) from error

    def storage(self, label: str, size: int, *, extra: str = "") -> Any:
        """Return a new storage buffer of ``size`` bytes, which is zero.

        Args:
            label: What it holds; errors name it.
            size: Rounded up to whole words of 16 bytes, which kernels may read it by.
            extra: More usages, as wgpu spells them.

        Raises:
            CapacityExceeded: No binding may be that large.
        """
        if size > self.largest_binding:
            raise CapacityExceeded(
                f"would take {size:,} bytes; {self.name} binds {self.largest_binding:,} at most",
                where=label,
                mend="Draw fewer Gaussians or a smaller image.",
            )
        usage = "STORAGE|COPY_DST|COPY_SRC" + (f"|{extra}" if extra else "")
        return self.raw.create_buffer(
            label=label, size=max(16, -(-size // 16) * 16), usage=usage
        )

    def uniform(self, label: str, size: int) -> Any:
        """Return a new uniform buffer of ``size`` bytes."""
        return self.raw.create_buffer(
            label=label, size=-(-size // 16) * 16, usage="UNIFORM|COPY_DST"
        )

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
