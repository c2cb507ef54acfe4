"""Reads a frame's GPU counters two frames later, so that the host does not wait for the GPU."""

__all__ = ["FRAMES_LATE", "LateCounts"]

import time
from collections import deque
from typing import Final, final

import numpy as np

from gsgen.runtime.gpu.readback import Staging
from gsgen.runtime.renderer.frame_plan import Plan

FRAMES_LATE: Final = 2
"""Frames that are in flight: the counts of a frame are read when the second one after it begins."""


@final
class LateCounts:
    """The GPU counters of frames that are still being drawn, oldest frame first.

    Attributes:
        waited: Seconds that the host waited for the GPU before the last frame; 0 if it kept up.
    """

    def __init__(self) -> None:
        self.waited = 0.0
        self._in_flight: deque[tuple[Staging, list[Staging]]] = deque()
        self._free: list[Staging] = []
        self._layout: object = None

    def __bool__(self) -> bool:
        return bool(self._in_flight)

    def staging(self, plan: Plan) -> Staging:
        """Return a staging buffer for a frame's GPU counters that no unfinished frame uses."""
        if self._layout is not plan.inputs:  # another plan has other buffers to copy from
            self._free, self._layout = [], plan.inputs
        return self._free.pop() if self._free else plan.counts_staging()

    def add(self, staging: Staging) -> None:
        """Begin to read the GPU counters of a frame that was just submitted."""
        staging.begin()
        self._in_flight.append((staging, self._free))

    def read(self, *, in_flight: int = FRAMES_LATE - 1) -> list[list[np.ndarray]]:
        """Return the GPU counters of all frames but the newest ``in_flight``, oldest frame first.

        Those of a frame are several if it has cells: see
        :func:`gsgen.runtime.renderer.frame_counts.frame_counts`.
        """
        began, counts = time.perf_counter(), []
        while len(self._in_flight) > in_flight:
            staging, free = self._in_flight.popleft()
            counts.append(list(staging.read_words().values()))
            free.append(staging)
        self.waited = time.perf_counter() - began
        return counts
