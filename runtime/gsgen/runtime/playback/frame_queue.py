"""Keeps frames of a scene in flight: the GPU draws one while the host reads the one before."""

__all__ = ["FrameQueue", "PlayStatistics"]

import time
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.errors import MemoryFull
from gsgen.runtime.renderer.late_counts import FrameInFlight
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame, Output
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData


@final
@dataclass(slots=True, kw_only=True)
class PlayStatistics:
    """How the host and the GPU worked together while a film was played.

    Attributes:
        frames: Number of frames that were handed out.
        in_flight: Most frames that were submitted, and not handed out yet, at the same time.
        waited: Seconds that the host stood still while it submitted and read frames: for the GPU,
            or for another process.
        growths: How often buffers were enlarged because more splats were drawn.
        redrawn: Number of frames that were drawn again because their buffers were too small.
    """

    frames: int = 0
    in_flight: int = 0
    waited: float = 0.0
    growths: int = 0
    redrawn: int = 0


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _DataState:
    """The arrays of a splat set at the time when a frame was submitted."""

    data: SplatData
    rows: Float[np.ndarray, "n 10"]
    appearance: Float[np.ndarray, "n c"]
    cells: Float[np.ndarray, "c 10"] | None
    count: int
    origin: tuple[float, float, float]

    @classmethod
    def of(cls, data: SplatData) -> "_DataState":
        return cls(
            data=data,
            rows=data.rows,
            appearance=data.appearance,
            cells=data.cells,
            count=data.count,
            origin=data.origin,
        )

    def restore(self) -> None:
        """Give the splat set these arrays; only those that differ are uploaded again."""
        data = self.data
        data.update(
            None if data.rows is self.rows else self.rows,
            None if data.appearance is self.appearance else self.appearance,
            self.count,
            None if data.cells is self.cells else self.cells,
            origin=self.origin,
        )


@final
class FrameQueue:
    """Frames of one scene in flight, which are handed out in order.

    A frame is submitted before the one before it is read. If its buffers turn out to be too small,
    it is drawn again when its turn comes, from the arrays that the scene had: they must not be
    written before.

    Args:
        renderer: Draws the frames.
        scene: The scene, whose values may change from frame to frame.
        background: Red, green, blue and alpha behind the scene.
        outputs: Outputs of each frame.

    Attributes:
        waits: Whether :meth:`submit` waits for each frame, which then takes no memory of its own.
        statistics: Statistics of all frames so far.
    """

    def __init__(
        self,
        renderer: Renderer,
        scene: Scene,
        background: Sequence[float],
        outputs: Collection[Output],
    ) -> None:
        self._renderer, self._scene = renderer, scene
        self._background, self._outputs = background, outputs
        self._queued_frames: deque[tuple[FrameInFlight | Frame, list[_DataState]]] = deque()
        self.waits = False
        self.statistics = PlayStatistics()

    def __len__(self) -> int:
        return len(self._queued_frames)

    def submit(self, camera: Camera, right: Camera | None = None) -> None:
        """Begin to draw the scene as a camera sees it; frames with a ``right`` eye are waited for.

        Raises:
            GsgenError: See :meth:`gsgen.runtime.renderer.renderer.Renderer.render`.
        """
        draw = self._renderer.render if self.waits else self._renderer.submit
        if right is not None:
            draw = partial(self._renderer.render, right=right)
        with self._update_statistics():
            frame = draw(self._scene, camera, background=self._background, outputs=self._outputs)
        self._queued_frames.append((frame, self._data_states()))
        self.statistics.in_flight = max(self.statistics.in_flight, len(self))

    def try_submit(self, camera: Camera, right: Camera | None = None) -> bool:
        """Begin to draw the scene; return False if there is no memory for another frame in flight.

        Raises:
            GsgenError: See :meth:`submit`; of a lack of memory only if the queue waits.
        """
        try:
            self.submit(camera, right)
        except MemoryFull:
            if self.waits:
                raise
            return False  # the error, which refers to buffers, ends here
        return True

    def take(self) -> Frame:
        """Return the oldest frame in flight, complete, after waiting for it alone.

        Raises:
            GsgenError: See :meth:`gsgen.runtime.renderer.renderer.Renderer.render`.
        """
        queued_frame, states = self._queued_frames.popleft()
        self.statistics.frames += 1
        if isinstance(queued_frame, Frame):
            return queued_frame
        with self._update_statistics():
            return self._renderer.collect(queued_frame) or self._redraw_frame(
                queued_frame.camera, states
            )

    def _redraw_frame(self, camera: Camera, states: list[_DataState]) -> Frame:
        """Draw a frame from the arrays that it was submitted with, and wait for it."""
        self.statistics.redrawn += 1
        current_states = self._data_states()
        for state in states:
            state.restore()
        try:
            return self._renderer.render(
                self._scene, camera, background=self._background, outputs=self._outputs
            )
        finally:
            for state in current_states:
                state.restore()

    def _data_states(self) -> list[_DataState]:
        sets = dict.fromkeys(splat_set.data for splat_set in self._scene.sets)
        return [_DataState.of(data) for data in sets]

    @contextmanager
    def _update_statistics(self) -> Iterator[None]:
        """Add to the statistics what happens in a ``with`` block."""
        growths, start = (self._renderer.growths, time.perf_counter() - time.thread_time())
        try:
            yield
        finally:
            stalled_seconds = time.perf_counter() - time.thread_time() - start
            self.statistics.waited += max(0.0, stalled_seconds)
            self.statistics.growths += self._renderer.growths - growths
