"""Copies Gaussians from a model's output buffers on the GPU into the renderer's buffers."""

__all__ = ["RepackRows"]

from typing import final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.kernel import THREADS, Kernel, Step


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
            THREADS=THREADS,
            COLUMNS=columns,
            WORDS=words,
            HALF_SOURCE=half_source,
            HALF_TARGET=half_target,
        )

    def step(self, numbers: Buffer, words: Buffer, rows: int) -> Step:
        """Return the dispatch that copies rows of a model output into a renderer's buffer."""
        return Step(self.kernel, (self.kernel.bind(numbers, words),), (-(-rows // THREADS), 1, 1))
