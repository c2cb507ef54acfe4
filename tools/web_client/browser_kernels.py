"""Kernels that only the browser's frame plans have; their shaders are in the runtime."""

__all__ = ["IMAGE_TILE", "PICTURE", "ImageTensors", "ImportLayer", "LiveCounts", "RepackRows"]

from typing import Final, final

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.splat_residency import PAGE_ROWS
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP, Kernel, Step

PICTURE: Final = np.dtype(
    {
        "names": [
            "size",
            "color_row",
            "depth_row",
            "first",
            "empty",
            "slope",
            "offset",
            "is_encoded",
        ],
        "formats": ["2u4", "u4", "u4", "u4", "f4", "f4", "f4", "u4"],
        "offsets": [0, 8, 12, 16, 20, 24, 28, 32],
        "itemsize": 48,
    }
)
"""The bytes of ``struct Picture`` in import_layer.wgsl."""

IMAGE_TILE: Final = np.dtype(
    {
        "names": [
            *("size", "tile", "corner", "channels", "is_linear"),
            *("low", "high", "background_alpha"),
        ],
        "formats": ["2u4", "2u4", "2u4", "u4", "u4", "f4", "f4", "f4"],
        "offsets": [0, 8, 16, 24, 28, 32, 36, 40],
        "itemsize": 48,
    }
)
"""The bytes of ``struct ImageTile`` in image_tile.wgsl."""


@final
class ImageTensors:
    """Kernels that copy a drawn image into a network's input, and its output into an image.

    ``fill`` is in ``image_to_tensor.wgsl``, ``add`` and ``finish`` in ``tensor_to_image.wgsl``.

    Args:
        device: Device of the kernels.
        half: Whether the tensor is float16.
    """

    def __init__(self, device: Device, *, half: bool) -> None:
        self.fill = Kernel(
            device, "image_to_tensor", "fill", ("urw",), HALF=half, THREADS=THREADS_PER_WORKGROUP
        )
        self.add, self.finish = (
            Kernel(device, "tensor_to_image", entry, groups, HALF=half)
            for entry, groups in (("add", ("uwrrw",)), ("finish", ("uwrrw", "r")))
        )


@final
class ImportLayer:
    """The kernel ``import_layer.wgsl``, which copies another renderer's picture and depths."""

    def __init__(self, device: Device) -> None:
        self.kernel = Kernel(device, "import_layer", "import_layer", ("urrw", "w"))


@final
class LiveCounts:
    """The kernel ``live_counts.wgsl``: counts the used rows of each of up to 64 GPU buffers."""

    def __init__(self, device: Device) -> None:
        self.kernel = Kernel(
            device,
            "live_counts",
            "divide",
            ("rw",),
            THREADS=THREADS_PER_WORKGROUP,
            PAGE_ROWS=PAGE_ROWS,
        )

    def step(self, total: Buffer, live: Buffer) -> Step:
        """Return the dispatch that counts the used rows of each page (GPU buffers of Gaussians).

        Args:
            total: The number of live rows, as int32.
            live: One word per page.
        """
        return Step(self.kernel, (self.kernel.bind(total, live),), (1, 1, 1))


@final
class RepackRows:
    """The kernel ``repack_rows.wgsl``, which copies model outputs into the renderer's buffers.

    Args:
        device: Device of the kernel.
        columns: Numbers of a source row.
        words: 32-bit words of a target row.
        half_source: Whether source numbers are float16.
        half_target: Whether target numbers are; only for a source that is.
    """

    def __init__(
        self, device: Device, columns: int, words: int, *, half_source: bool, half_target: bool
    ) -> None:
        self.kernel = Kernel(
            device,
            "repack_rows",
            "repack",
            ("rw",),
            THREADS=THREADS_PER_WORKGROUP,
            COLUMNS=columns,
            WORDS=words,
            HALF_SOURCE=half_source,
            HALF_TARGET=half_target,
        )

    def step(self, numbers: Buffer, words: Buffer, rows: int) -> Step:
        """Return the dispatch that copies rows of a model output into a renderer's buffer."""
        return Step(
            self.kernel,
            (self.kernel.bind(numbers, words),),
            (-(-rows // THREADS_PER_WORKGROUP), 1, 1),
        )
