"""Plays segments: files that follow each other in time, of which two are open at most."""

__all__ = ["Segment", "SegmentedSource", "read_segments"]

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Final, final

import numpy as np

from gsgen.contract.spec.manifest import Input
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.scene_fields import Fields
from gsgen.runtime.sources.source import Source, Values

_MAX_CAPACITY: Final = 1 << 30


@final
@dataclass(frozen=True, slots=True)
class Segment:
    """A splat file or generator of a scene file, and how many seconds it lasts."""

    path: Path
    seconds: float


def read_segments(fields: Fields, folder: Path) -> tuple[tuple[Segment, ...], int]:
    """Return the segments of a model of a scene file, and their capacity; none and 0 without.

    Raises:
        SceneInvalid: A field is missing, or has another value than expected.
    """
    segments = []
    for part in fields.parts("segments"):
        seconds = part.number("seconds", low=0)
        if not seconds:
            actual = "missing" if seconds is None else 0
            part.refuse("seconds", f"is {actual}, expected seconds above 0")
        segments.append(Segment(folder / part.required_text("path"), seconds))
        part.close()
    capacity = fields.integer("capacity", low=1, high=_MAX_CAPACITY)
    if segments and fields.has_field("path"):
        fields.refuse("path", "excludes `segments`: leave one of them out")
    if bool(segments) != (capacity is not None):
        fields.refuse("capacity", "is the most Gaussians of `segments`: give both or neither")
    return tuple(segments), capacity or 0


@final
class SegmentedSource(Source):
    """A source of Gaussians whose input ``time``, in seconds, chooses one of several files.

    The time of a generator goes through its range while its segment lasts. The file of the moment
    is open, and the next one is being opened; after the last one the first is next.

    Args:
        name: Of the source, for messages.
        segments: The files in order.
        capacity: Gaussians of the largest segment.
        open_file: Opens a file.

    Raises:
        SceneInvalid: A segment has more Gaussians than the capacity, or colours of another kind
            than the first one; raised when it is shown.
    """

    def __init__(
        self,
        name: str,
        segments: Sequence[Segment],
        capacity: int,
        open_file: Callable[[Path], Source],
    ) -> None:
        self.name, self._segments, self._open_file = name, list(segments), open_file
        self._ends = list(accumulate(segment.seconds for segment in segments))
        self.inputs = (Input(name="time", role="time", shape=(1,), range=(0, self._ends[-1])),)
        self._capacity = capacity
        self._opener = ThreadPoolExecutor(1, thread_name_prefix="gsgen segments")
        self._opened: dict[int, Future[Source]] = {}
        self._time = 0.0
        self._shown: tuple[int, tuple[int, ...]] = (-1, ())
        try:
            first = self._source(0)
            self.up, self.space = first.up, first.space
            self.antialias, self.color_space = first.antialias, first.color_space
            self.weighted = first.weighted
            self.data = SplatData(
                np.zeros((capacity, first.data.rows.shape[1]), np.float32),
                np.zeros((capacity, first.data.appearance.shape[1]), np.float32),
                first.data.space,
                count=0,
                origin=first.data.origin,
            )
            self.update(None, {})
        except BaseException:
            self.close()
            raise

    def _index(self) -> int:
        """Return the segment of the present time; the last one at the end."""
        number = int(np.searchsorted(self._ends, self._time, side="right"))
        return min(number, len(self._segments) - 1)

    def _source(self, index: int) -> Source:
        """Return the source of a segment, begin to open the next, and close the others."""
        following = (index + 1) % len(self._segments)
        for other in self._opened.keys() - {index, following}:
            self._close(self._opened.pop(other))
        opened = self._opened.get(index)
        if opened is not None and opened.done() and opened.exception() is not None:
            del self._opened[index]  # in vain before its time: it is tried again
        for number in (index, following):
            if number not in self._opened:
                path = self._segments[number].path
                self._opened[number] = self._opener.submit(self._open_file, path)
        try:
            return self._opened[index].result()
        except BaseException:
            del self._opened[index]  # the next frame tries again
            raise

    def _close(self, opened: Future[Source]) -> None:
        if not opened.cancel() and opened.exception() is None:
            opened.result().close()

    @property
    def follows_camera(self) -> bool:
        """Whether the shown segment's Gaussians depend on the camera."""
        return self._source(self._index()).follows_camera

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Begin to compute the moment of a time in seconds."""
        value = values.get("time", self._time)
        self._time = float(np.clip(np.asarray(value).reshape(-1)[0], 0, self._ends[-1]))
        index = self._index()
        source, seconds = self._source(index), self._segments[index].seconds
        share = float(np.clip(1 - (self._ends[index] - self._time) / seconds, 0, 1))
        own: dict[str, object] = {}
        if source.time is not None:
            low, high = source.time.range or (0.0, 1.0)
            own[source.time.name] = low + (high - low) * share
        source.start(camera, own, frame)

    def finish(self) -> None:
        """Wait for the segment's Gaussians, which replace the last ones."""
        index = self._index()
        source = self._opened[index].result()
        source.finish()
        if self._shown == (index, source.state):
            return
        self._take(self._segments[index].path, source)
        self.seconds, self._shown = source.seconds, (index, source.state)

    def _take(self, path: Path, source: Source) -> None:
        """Copy the Gaussians of a segment into arrays of the capacity."""
        if source.pools or source.meshes:
            message = "is a tileset or has a mesh, expected a splat file or a generator"
            raise SceneInvalid(message, where=str(path), hint="Give it a model of its own.")
        data, channels = source.data, self.data.appearance.shape[1]
        facts = (data.space, source.antialias, source.color_space, data.origin)
        expected = (self.data.space, self.antialias, self.color_space, self.data.origin)
        is_other = facts != expected or source.weighted != self.weighted
        if is_other or data.appearance.shape[1] > channels:
            message = f"has {facts} of {data.appearance.shape[1]} numbers, expected {expected} of {channels}"
            hint = "Segments have colours, blending, antialiasing and origin of one kind."
            raise SceneInvalid(message, where=str(path), hint=hint)
        if data.count > self._capacity:
            message = f"has {data.count:,} Gaussians, expected at most {self._capacity:,}"
            raise SceneInvalid(message, where=str(path), hint="Raise the capacity.")
        rows = np.zeros((self._capacity, data.rows.shape[1]), np.float32)
        appearance = np.zeros((self._capacity, channels), np.float32)
        rows[: data.count] = data.rows[: data.count]
        appearance[: data.count, : data.appearance.shape[1]] = data.appearance[: data.count]
        self.data.update(rows, appearance, data.count)

    @property
    def _present(self) -> Source | None:
        """The source of the present time; None if its file could not be opened."""
        opened = self._opened.get(self._index())
        return None if opened is None or opened.exception() is not None else opened.result()

    @property
    def ready(self) -> bool:
        """Whether the segment has computed the moment that :meth:`start` requested."""
        return self._present is None or self._present.ready

    def abandon(self) -> None:
        """Wait for the moment that :meth:`start` requested, and discard its result or error."""
        if self._present is not None:
            self._present.abandon()

    def interrupt(self) -> None:
        """Stop computing the moment that :meth:`start` requested."""
        if self._present is not None:
            self._present.interrupt()

    def hold_frames(self, frames: int) -> bool:
        """Return True: each frame has arrays of its own."""
        return True

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of the input ``time``."""
        return {"time": (1,)}[name]

    def close(self) -> None:
        """Close the open segments."""
        for opened in self._opened.values():
            self._close(opened)
        self._opened.clear()
        self._opener.shutdown()
