"""Plans tile requests: first tiles that the camera needs now, then tiles for later."""

__all__ = ["Link", "RequestPlanner"]

from collections.abc import Sequence
from typing import Final, Literal, Protocol, final

import numpy as np
from jaxtyping import Bool, Int64

from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.prefetch import PREDICTION_HORIZON, PathPrefetch, Prefetch
from gsgen.tiles.selection.cut import TileCut
from gsgen.tiles.selection.request_order import missing_tiles, request_order
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.streaming.metrics import MetricsRecorder

CANCEL_PRIORITY_FRACTION: Final = 0.5
"""A request is cancelled only below this share of its bytes."""
MAX_WASTE_FRACTION: Final = 0.15
"""Of the received bytes, as far as they are expected to stay unseen."""
MAX_UNSEEN_FRACTION: Final = 0.25
"""Of the received bytes, those that may still be seen included."""

_RequestPurpose = Literal["needed", "prefetched", "finer"]
"""Why a tile was requested."""

_PREFETCH_TIMEOUT: Final = 2 * PREDICTION_HORIZON  # seconds: then a prefetched tile is wasted
_PRIOR_TILE_COUNT: Final = 4.0  # prefetched tiles, half of them seen, that precision begins with


class Link(Protocol):
    """Protocol of network links: connections to a server of tiles, real or simulated."""

    @property
    def free_request_count(self) -> int:
        """The number of tile requests that can be made now."""
        ...

    def request(self, tile: int) -> None:
        """Begin to fetch the content files of a tile."""
        ...

    def progress(self, tile: int) -> float:
        """Return the fraction of a requested tile's bytes that were received so far."""
        ...

    def cancel(self, tile: int) -> int:
        """Cancel a tile request; return the number of bytes received."""
        ...


@final
class RequestPlanner:
    """Requests tiles over network connections, in the order in which the camera needs tiles.

    Seen tiles come first, in the order of :mod:`gsgen.tiles.selection.request_order`. Only while
    none of them is missing, tiles of ``prefetch`` are requested, as long as the expected waste stays
    in its bound (the planner measures how many of the prefetched tiles are seen), then finer files.
    When a seen tile is missing, requests of both kinds that are less than half done are cancelled.

    Args:
        tree: The tiles.
        link: The connections.
        recorder: Receives requests and cancellations.
        prefetch: None for a client that only reacts.
    """

    def __init__(
        self, tree: TileTree, link: Link, recorder: MetricsRecorder, prefetch: Prefetch | None
    ) -> None:
        self._tree, self._fetch_link, self._recorder = tree, link, recorder
        self.prefetch(prefetch)
        self._requested_tiles: Int64[np.ndarray, " m"] = np.zeros(0, np.int64)
        self._purpose_by_pending_tile: dict[int, _RequestPurpose] = {}
        self._ledger = _PrefetchLedger(tree.size)

    @property
    def in_flight(self) -> frozenset[int]:
        """The tiles that were requested and have not arrived."""
        return frozenset(self._purpose_by_pending_tile)

    def prefetch(self, prefetch: Prefetch | None) -> None:
        """Prefetch as ``prefetch`` says from now on. Nothing is wasted along paths that are known."""
        self._prefetch = prefetch
        self._is_bounded = not isinstance(prefetch, PathPrefetch)

    def frame(self, pose: Pose, cut: TileCut, loaded: Bool[np.ndarray, " n"]) -> None:
        """Set the tiles that a new frame needs, and cancel prefetches that delay these tiles.

        Args:
            pose: Of the camera.
            cut: Of the camera.
            loaded: Tiles that are there, or cannot be had.
        """
        self._requested_tiles = request_order(self._tree, cut)
        if self._prefetch:
            self._ledger.frame(pose.time, cut.seen & loaded)
            self._prefetch.observe(pose)
        for tile in self._tiles_by_purpose("prefetched"):
            if cut.seen[tile]:
                self._purpose_by_pending_tile[tile] = "needed"
        if self.missing(loaded):
            for tile in self._tiles_by_purpose("prefetched", "finer"):
                if self._fetch_link.progress(tile) < CANCEL_PRIORITY_FRACTION:
                    self._recorder.cancel(self._fetch_link.cancel(tile))
                    del self._purpose_by_pending_tile[tile]

    def arrive(self, tile: int, time: float) -> None:
        """Record that the contents of a tile arrived at ``time``."""
        self._recorder.arrive(tile, time)
        if self._purpose_by_pending_tile.pop(tile, None) == "prefetched":
            self._ledger.arrive(tile, time)

    def fail(self, tile: int) -> None:
        """Record that a tile request ended with an error."""
        self._purpose_by_pending_tile.pop(tile, None)

    def fill(self, loaded: Bool[np.ndarray, " n"], finer_tiles: Sequence[int] = ()) -> None:
        """Request tiles while network connections are free.

        Args:
            loaded: Tiles that are there, or cannot be had.
            finer_tiles: Loaded tiles that have a finer file, in order of request.
        """
        while self._fetch_link.free_request_count > 0:
            tile, purpose = self._next_request(loaded, finer_tiles)
            if tile is None:
                break
            self._purpose_by_pending_tile[tile] = purpose
            self._recorder.request()
            self._fetch_link.request(tile)

    def begin(self, tile: int) -> None:
        """Record that the network link has started the queued request of a needed tile."""
        self._purpose_by_pending_tile[tile] = "needed"
        self._recorder.request()

    def missing(self, loaded: Bool[np.ndarray, " n"]) -> list[int]:
        """Return the seen tiles that are neither loaded nor requested, the most urgent first."""
        rows = missing_tiles(self._requested_tiles, loaded).tolist()
        return [tile for tile in rows if tile not in self._purpose_by_pending_tile]

    def _tiles_by_purpose(self, *purposes: _RequestPurpose) -> list[int]:
        """Return the tiles in flight that were requested for one of some purposes."""
        return [
            tile for tile, purpose in self._purpose_by_pending_tile.items() if purpose in purposes
        ]

    def _next_request(
        self, loaded: Bool[np.ndarray, " n"], finer_tiles: Sequence[int]
    ) -> tuple[int | None, _RequestPurpose]:
        # 1. Seen tiles; while one of them is missing or in flight, nothing else is requested.
        missing = self.missing(loaded)
        if missing:
            return missing[0], "needed"
        if not loaded[self._requested_tiles].all():
            return None, "needed"
        finer = next(
            (tile for tile in finer_tiles if tile not in self._purpose_by_pending_tile), None
        )
        is_film = isinstance(self._prefetch, PathPrefetch) and self._prefetch.is_film
        if finer is not None and is_film:
            return finer, "finer"  # a frame of a film waits for it
        # 2. The most urgent tile that will be seen, if its expected waste is within the bound.
        candidates = self._prefetch.candidates(loaded) if self._prefetch else []
        for tile in candidates:
            if tile not in self._purpose_by_pending_tile:
                if self._can_prefetch(int(self._tree.size[tile])):
                    return tile, "prefetched"
                break
        # 3. The finer file that shows most for its bytes.
        return finer, "finer"

    def _can_prefetch(self, size: int) -> bool:
        """Return whether one more prefetch keeps the expected share of unused bytes low enough."""
        if not self._is_bounded:
            return True
        requested_bytes = int(self._tree.size[self._tiles_by_purpose("prefetched")].sum()) + size
        received = self._recorder.bytes + requested_bytes
        unseen_total = self._recorder.unseen_bytes + requested_bytes
        pending = self._ledger.pending_bytes + requested_bytes
        expected = unseen_total - pending * self._ledger.precision
        return (
            expected <= MAX_WASTE_FRACTION * received
            and unseen_total <= MAX_UNSEEN_FRACTION * received
        )


@final
class _PrefetchLedger:
    """Counts the prefetched tiles that were seen later, and those fetched in vain."""

    def __init__(self, size: Int64[np.ndarray, " n"]) -> None:
        self._size = size
        self._arrivals: dict[int, float] = {}
        self._seen_count = self._late_tile_count = 0

    @property
    def pending_bytes(self) -> int:
        """The bytes of prefetched tiles that were not seen yet, and may still be."""
        return int(self._size[list(self._arrivals)].sum())

    @property
    def precision(self) -> float:
        """The fraction of prefetched tiles that were seen in time; a half before the first tile."""
        return (self._seen_count + _PRIOR_TILE_COUNT / 2) / (
            self._seen_count + self._late_tile_count + _PRIOR_TILE_COUNT
        )

    def arrive(self, tile: int, time: float) -> None:
        """Record that a prefetched tile has arrived."""
        self._arrivals[tile] = time

    def frame(self, time: float, seen: Bool[np.ndarray, " n"]) -> None:
        """Count prefetched tiles as used if seen now, or as wasted if unseen for too long."""
        for tile, arrival in list(self._arrivals.items()):
            is_late = time - arrival > _PREFETCH_TIMEOUT
            if seen[tile] or is_late:
                self._seen_count += bool(seen[tile])
                self._late_tile_count += is_late and not seen[tile]
                del self._arrivals[tile]
