"""Fetches and decodes the contents of tiles on threads, for a streaming session."""

__all__ = ["RETRY_AFTER", "FailedTiles", "FetchLink", "FetchResult"]

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from queue import SimpleQueue
from threading import Event, Lock, Semaphore, Thread
from typing import Final, Generic, TypeVar, final

import numpy as np
from jaxtyping import Bool

from gsgen.contract.errors import GsgenError
from gsgen.tiles.errors import StoreUnavailable

FetchedType = TypeVar("FetchedType")
DecodedType = TypeVar("DecodedType")
RETRY_AFTER: Final = 30.0
"""Seconds after which a file that could not be had for now is requested again, at first."""
_MOST_AWAITED_FAILURES: Final = 5  # of a tile for which a picture still waits
_DECODER_THREADS = 2  # threads that decode at once: more would take frames their time

ByteProgressCallback = Callable[[int], None]


@final
@dataclass(frozen=True, slots=True)
class FetchResult(Generic[DecodedType]):
    """The result of a tile request: the decoded content, or the error that prevented it.

    Attributes:
        tile: Key of the tile.
        content: The decoded content; None where ``error`` says why.
        error: Why there is no content.
    """

    tile: int
    content: DecodedType | None
    error: GsgenError | None


class _Cancelled(Exception):
    """Raised in a thread that fetches a tile if the request was cancelled."""


@final
class _Request:
    def __init__(self, tile: int) -> None:
        self.tile, self.received = tile, 0
        self.is_cancelled = False

    def on_bytes(self, received: int) -> None:
        self.received = received
        if self.is_cancelled:
            raise _Cancelled


@final
class FetchLink(Generic[FetchedType, DecodedType]):
    """Fetches tiles, each request on a thread of its own that ends with the process.

    A connection is free again as soon as its bytes are there, while they are decoded, or as soon
    as its request failed; then the link requests the next tile of its queue by itself.

    Args:
        fetch: Reads the files of a tile, and reports how many came; called on threads.
        decode: Decodes them; called on threads.
        size: Bytes of each tile, for progress.
        connections: How many requests run at once.
    """

    def __init__(
        self,
        fetch: Callable[[int, ByteProgressCallback], FetchedType],
        decode: Callable[[int, FetchedType], DecodedType],
        size: Callable[[int], int],
        connections: int,
    ) -> None:
        self._fetch_content, self._decode_content, self._size = fetch, decode, size
        self._connections = connections
        self._decoders = Semaphore(_DECODER_THREADS)
        self._active_requests: dict[int, _Request] = {}
        self._queue: deque[int] = deque()
        self._started_requests: list[int] = []
        self._lock = Lock()
        self._results: SimpleQueue[FetchResult[DecodedType]] = SimpleQueue()
        self._result_event = Event()
        self._fetch_crash: Exception | None = None

    @property
    def free_request_count(self) -> int:
        """The number of tile requests that can be made now."""
        with self._lock:
            return self._connections - len(self._active_requests)

    def request(self, tile: int) -> None:
        """Begin to fetch a tile on a thread of its own."""
        with self._lock:
            self._begin_transfer(tile)

    def queue(self, tiles: Iterable[int]) -> None:
        """Replace the queue of tiles; each is requested when a network connection is free."""
        with self._lock:
            self._queue = deque(tiles)

    def take_started(self) -> list[int]:
        """Return the queued tiles whose requests began since the last call."""
        with self._lock:
            started, self._started_requests = self._started_requests, []
        return started

    def _begin_transfer(self, tile: int) -> None:
        """Start a thread that fetches a tile; the caller holds ``self._lock``."""
        request = self._active_requests[tile] = _Request(tile)
        Thread(target=self._run_request, args=(request,), name="gsgen-fetch", daemon=True).start()

    def progress(self, tile: int) -> float:
        """Return the received fraction of a tile's bytes; 1 while the tile is decoded."""
        with self._lock:
            request = self._active_requests.get(tile)
        return 1.0 if request is None else request.received / max(self._size(tile), 1)

    def cancel(self, tile: int) -> int:
        """Cancel an incomplete tile request; return the number of bytes received."""
        with self._lock:
            request = self._active_requests.pop(tile, None)
            if request is None:  # its bytes have come in the meantime
                return 0
            request.is_cancelled = True
            return request.received

    def poll(self) -> list[FetchResult[DecodedType]]:
        """Return the tiles that arrived or failed since the last call.

        Raises:
            Exception: A fault of gsgen on one of the threads.
        """
        self._result_event.clear()
        if self._fetch_crash is not None:
            raise self._fetch_crash
        results = []
        while not self._results.empty():
            results.append(self._results.get())
        return results

    def wait(self, seconds: float) -> None:
        """Sleep until a requested tile arrives or fails, for a limited time."""
        self._result_event.wait(seconds)

    def close(self) -> None:
        """Cancel all tile requests; each thread ends after the piece that it is reading."""
        with self._lock:
            self._queue.clear()
            for request in self._active_requests.values():
                request.is_cancelled = True
            self._active_requests.clear()

    def _run_request(self, request: _Request) -> None:
        try:
            data = self._fetch_content(request.tile, request.on_bytes)
        except _Cancelled:
            return
        except Exception as error:
            if self._finish_request(request):
                self._queue_failure(request.tile, error)
            return
        if self._finish_request(request):
            with self._decoders:
                self._decode_and_answer(request.tile, data)

    def _finish_request(self, request: _Request) -> bool:
        """Free a finished request's connection; return False if the request was cancelled."""
        with self._lock:
            if request.is_cancelled:
                return False
            del self._active_requests[request.tile]
            while self._queue and len(self._active_requests) < self._connections:
                tile = self._queue.popleft()
                self._started_requests.append(tile)
                self._begin_transfer(tile)
            return True

    def _decode_and_answer(self, tile: int, data: FetchedType) -> None:
        try:
            content = self._decode_content(tile, data)
        except Exception as error:
            self._queue_failure(tile, error)
        else:
            self._queue_result(FetchResult(tile, content, None))

    def _queue_failure(self, tile: int, error: Exception) -> None:
        """Answer that a tile cannot be had; a fault of gsgen is raised where results are polled."""
        if isinstance(error, GsgenError):
            self._queue_result(FetchResult(tile, None, error))
        else:
            self._fetch_crash = error
            self._result_event.set()

    def _queue_result(self, result: FetchResult[DecodedType]) -> None:
        self._results.put(result)
        self._result_event.set()


@final
class FailedTiles:
    """The tiles whose last requests failed.

    A tile that a server does not give for now is requested again; each failure doubles the time
    until then, so that tiles which hold a connection do not hold it most of the time. Missing and
    damaged files are not requested again.

    Attributes:
        first_cause: The first error, in one line; empty without any.

    Args:
        count: Number of tiles.
        retry_seconds: Until the first retry of a tile.
    """

    def __init__(self, count: int, retry_seconds: float) -> None:
        self.first_cause = ""
        self._retry_seconds = retry_seconds
        self._retry_at = np.full(count, -math.inf)
        self._failures = np.zeros(count, np.int64)

    def add(self, tile: int, error: GsgenError, time: float) -> str:
        """Record that the request of a tile failed; return the error in one line."""
        text = " ".join(str(error).split())
        self.first_cause = self.first_cause or text
        retry_delay = math.inf
        if isinstance(error, StoreUnavailable):
            retry_delay = self._retry_seconds * 2.0 ** int(self._failures[tile])
        self._failures[tile] += 1
        self._retry_at[tile] = time + retry_delay
        return text

    def mask(self, time: float) -> Bool[np.ndarray, " n"]:
        """Return the mask of the tiles that are not requested at a time."""
        return self._retry_at > time

    @property
    def is_awaited(self) -> Bool[np.ndarray, " n"]:
        """The mask of the tiles that are requested again, and failed only a few times so far."""
        is_repeated = np.isfinite(self._retry_at)
        return np.asarray(is_repeated & (self._failures <= _MOST_AWAITED_FAILURES))
