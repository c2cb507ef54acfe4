"""Reads a frame's GPU counters or images while the GPU draws the next one, without waiting."""

__all__ = ["MAX_FRAMES_IN_FLIGHT", "DelayedCounts", "FrameInFlight", "Readbacks"]

import time
from collections import deque
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from gsgen.runtime.gpu.readback import StagingBuffers
from gsgen.runtime.renderer.bands import CountsAndImages
from gsgen.runtime.renderer.frame_images import FrameReadback
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene

MAX_FRAMES_IN_FLIGHT: Final = 2
"""Frames that are in flight: the counts of a frame are read when the second one after it begins."""


@final
class DelayedCounts:
    """The GPU counters of frames that are still being drawn, oldest frame first.

    Attributes:
        waited: Seconds that the host waited for the GPU before the last frame; 0 if it kept up.
    """

    def __init__(self) -> None:
        self.wait_seconds = 0.0
        self._pending_readbacks: deque[tuple[StagingBuffers, list[StagingBuffers]]] = deque()
        self._free_staging: list[StagingBuffers] = []
        self._layout: object = None

    def __bool__(self) -> bool:
        return bool(self._pending_readbacks)

    def staging(self, plan: Plan) -> StagingBuffers:
        """Return a staging buffer for a frame's GPU counters that no unfinished frame uses."""
        if self._layout is not plan.inputs:  # another plan has other buffers to copy from
            self._free_staging, self._layout = [], plan.inputs
        return self._free_staging.pop() if self._free_staging else plan.counts_staging()

    def add(self, staging: StagingBuffers) -> None:
        """Begin to read the GPU counters of a frame that was just submitted."""
        staging.begin()
        self._pending_readbacks.append((staging, self._free_staging))

    def read(self, *, in_flight: int = MAX_FRAMES_IN_FLIGHT - 1) -> list[list[np.ndarray]]:
        """Return the GPU counters of all frames but the newest ``in_flight``, oldest frame first.

        Those of a frame are several if it has cells: see
        :func:`gsgen.runtime.renderer.frame_counts.frame_counts`.
        """
        start_time, counts = time.perf_counter(), []
        while len(self._pending_readbacks) > in_flight:
            staging, free_staging = self._pending_readbacks.popleft()
            counts.append(list(staging.read_words().values()))
            free_staging.append(staging)
        self.wait_seconds = time.perf_counter() - start_time
        return counts


@final
class Readbacks:
    """Readbacks of frames of one plan, which are used again once their images were read."""

    def __init__(self) -> None:
        self._free_staging: list[FrameReadback] = []
        self._layout: object = None

    def take(self, plan: Plan) -> FrameReadback:
        """Return a readback of the plan's images that no frame in flight uses."""
        if self._layout is not plan.images:  # another plan has other buffers to copy from
            self._free_staging, self._layout = [], plan.images
        return self._free_staging.pop() if self._free_staging else plan.readback()

    def clear(self) -> None:
        """Free the readbacks that no frame uses."""
        self._free_staging, self._layout = [], None

    def return_readback(self, readback: FrameReadback) -> None:
        """Keep a readback for a later frame, unless there is another plan now."""
        if readback.images is self._layout:
            self._free_staging.append(readback)


@final
@dataclass(frozen=True, slots=True, eq=False)
class FrameInFlight:
    """A frame that was submitted to the GPU, and whose images were not read yet.

    Attributes:
        scene: The scene.
        camera: The camera.
        opacity_behind: Alpha of the background.
        images: Receives counters and images; or both, if the frame had to be waited for.
    """

    scene: Scene
    camera: Camera
    opacity_behind: float
    images: FrameReadback | CountsAndImages
