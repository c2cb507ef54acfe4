"""Metrics of tile streaming: hits, delays, waste and holes, for a session or a simulation."""

__all__ = ["MetricsRecorder", "StreamingMetrics"]

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Int64

from gsgen.tiles.selection.cut import TileCut

GOOD_QUALITY_SHARE: Final = 0.9
"""Share of the wanted tiles that makes a frame good."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StreamingMetrics:
    """Measures of how well a tileset was streamed to a camera.

    An entry is a tile that is wanted in a frame and was not wanted in the frame before.

    Attributes:
        hit_rate: Share of the entries whose tile was there.
        waste: Share of the bytes that were never seen after they arrived.
        first_good_s: Seconds until 90 % of the wanted tiles were there; NaN if never.
        share_good: Share of the frames in which they were.
        mean_delay_s: Mean time from an entry to its tile, over all entries; hits have 0.
        p95_delay_s: 95th percentile of the same.
        hole_frames: Frames with a wanted tile that had neither content nor a loaded ancestor.
        entries: Number of entries.
        bytes: Received, those of cancelled requests too.
        requests: Number of requests.
    """

    hit_rate: float
    waste: float
    first_good_s: float
    share_good: float
    mean_delay_s: float
    p95_delay_s: float
    hole_frames: int
    entries: int
    bytes: int
    requests: int


@final
class MetricsRecorder:
    """Collects the streaming metrics of one tileset, frame by frame.

    Args:
        parent: Index of the tile above each tile; −1 for the root.
        size: Bytes of each tile.
    """

    def __init__(self, parent: Int64[np.ndarray, " n"], size: Int64[np.ndarray, " n"]) -> None:
        count = len(parent)
        self._tile_parents, self._size = parent, size
        self._selected_tiles = np.zeros(count, bool)
        self._unseen_sizes = np.zeros(count, np.int64)  # of files that came and were not seen
        self._wanted_times_by_tile: dict[int, list[float]] = {}
        self._tile_delays: list[float] = []
        self._hit_count = self._frame_count = self._good_frame_count = self._hole_frame_count = 0
        self._first_good_frame_time = math.nan
        self._start_seconds: float | None = None
        self._time = 0.0
        self._wasted_bytes = 0
        self.bytes = self.requests = 0

    @property
    def unseen_bytes(self) -> int:
        """The bytes of tiles that arrived but were not seen, and of cancelled requests."""
        return int(self._unseen_sizes.sum()) + self._wasted_bytes

    def request(self) -> None:
        """Count one request of a streamed tile."""
        self.requests += 1

    def arrive(self, tile: int, time: float) -> None:
        """Record that a streamed tile was received completely at ``time``."""
        self.bytes += int(self._size[tile])
        self._wasted_bytes += int(self._unseen_sizes[tile])  # dropped unseen, and asked for again
        self._unseen_sizes[tile] = self._size[tile]
        self._tile_delays += [time - entry for entry in self._wanted_times_by_tile.pop(tile, [])]

    def cancel(self, received: int) -> None:
        """Record that a tile request was cancelled after ``received`` bytes."""
        self.bytes += received
        self._wasted_bytes += received

    def frame(self, time: float, cut: TileCut, loaded: Bool[np.ndarray, " n"]) -> None:
        """Record the tiles that a frame needs, and the tiles that are loaded."""
        self._time = time
        self._start_seconds = time if self._start_seconds is None else self._start_seconds
        self._unseen_sizes[cut.seen & loaded] = 0
        entries = cut.selected & ~self._selected_tiles
        self._selected_tiles = cut.selected.copy()
        hit_count = int((entries & loaded).sum())
        self._hit_count += hit_count
        self._tile_delays += [0.0] * hit_count
        for tile in np.flatnonzero(entries & ~loaded).tolist():
            self._wanted_times_by_tile.setdefault(tile, []).append(time)
        self._frame_count += 1
        count, loaded_count = int(cut.selected.sum()), int((cut.selected & loaded).sum())
        if loaded_count >= GOOD_QUALITY_SHARE * count:
            self._good_frame_count += 1
            if math.isnan(self._first_good_frame_time):
                self._first_good_frame_time = time - self._start_seconds
        self._hole_frame_count += self._has_missing_tile(cut.selected, loaded)

    def _has_missing_tile(
        self, needed: Bool[np.ndarray, " n"], loaded: Bool[np.ndarray, " n"]
    ) -> bool:
        """Return whether a wanted tile has neither content nor a loaded ancestor."""
        rows = np.flatnonzero(needed & ~loaded)
        while len(rows):
            rows = self._tile_parents[rows]
            if (rows < 0).any():
                return True
            rows = np.unique(rows[~loaded[rows]])
        return False

    def summary(self) -> StreamingMetrics:
        """Return the streaming metrics of all frames; missing tiles count as waiting until now."""
        waits = [
            self._time - entry
            for entries in self._wanted_times_by_tile.values()
            for entry in entries
        ]
        tile_delays = np.array([*self._tile_delays, *waits])
        count = len(tile_delays)
        return StreamingMetrics(
            hit_rate=self._hit_count / count if count else 1.0,
            waste=self.unseen_bytes / self.bytes if self.bytes else 0.0,
            first_good_s=self._first_good_frame_time,
            share_good=self._good_frame_count / self._frame_count if self._frame_count else 1.0,
            mean_delay_s=float(tile_delays.mean()) if count else 0.0,
            p95_delay_s=float(np.percentile(tile_delays, 95)) if count else 0.0,
            hole_frames=self._hole_frame_count,
            entries=count,
            bytes=self.bytes,
            requests=self.requests,
        )
