"""Replays the event log of a streamed flight, and compares each frame's decisions with the log."""

__all__ = ["FrameDifference", "ReplayLink", "replay_log"]

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.tiles.errors import StoreUnavailable, TilesetInvalid
from gsgen.tiles.json_values import JsonObject, shorten
from gsgen.tiles.loading import load_tileset
from gsgen.tiles.prediction.prefetch import HORIZON
from gsgen.tiles.quality_ladder import load_ladder
from gsgen.tiles.selection.quality_choice import QualityChooser
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.streaming.contents import ContentReader
from gsgen.tiles.streaming.disk_cache import DiskCache, default_cache_folder
from gsgen.tiles.streaming.events import FrameEvents, read_events, read_session_record, tree_digest
from gsgen.tiles.streaming.fetch import FetchResult
from gsgen.tiles.streaming.session import SessionOptions, TilesetSession
from gsgen.tiles.streaming.session_frame import SessionFrame, TileArrival


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FrameDifference:
    """The first decision of a replayed streaming session that its event log does not have.

    Attributes:
        frame: Number of the frame, from 1.
        line: Line of the event log.
        time: Of the frame, in seconds.
        decision: ``arrived``, ``evicted``, ``drawn`` or ``missing``, as the event log names them.
        logged: That decision in the event log.
        replayed: That decision in the replay.
    """

    frame: int
    line: int
    time: float
    decision: str
    logged: object
    replayed: object

    def __str__(self) -> str:
        return (
            f"frame {self.frame} (line {self.line}, {self.time:.3f} s) is the first to differ: "
            f"{self.decision} {_entries(self.replayed, self.logged)}; the event log has "
            f"{_entries(self.logged, self.replayed)}"
        )


def _entries(decision: object, other: object) -> str:
    """Describe a streaming decision by the items that another lacks; by all if it lacks none."""
    if isinstance(decision, tuple) and isinstance(other, tuple):
        only = tuple(entry for entry in decision if entry not in other)
        decision = list(only or decision)
    return shorten(decision)


def replay_log(source: str | Path, log: Path) -> tuple[int, FrameDifference | None]:
    """Replay the event log of a streamed flight through a new streaming session.

    Cameras, times and arriving tiles are those of the log; the session decides again what to upload,
    evict and draw. Tile requests depend on the network, and are not compared.

    Args:
        source: The tileset: ``tileset.json``, its folder, a ``.3tz`` archive, or an address.
        log: The event log.

    Returns:
        The number of equal frames, and the first difference; None without one.

    Raises:
        InputUnreadable: The log or a file of the tileset cannot be read.
        ConfigInvalid: The log is of another tileset.
    """
    record = read_session_record(log)
    options, digest = _session_options(record.child("options")), record.text("tiles")
    store, index = open_store(source)
    with store:
        tileset = load_tileset(store, index, name=str(source))
        tree = TileTree.of_tileset(tileset, store)
        if tree_digest(tree) != digest:
            raise ConfigInvalid(
                f"the event log is of another tileset than {source}",
                where=str(log),
                hint="Name the tileset that was streamed when the event log was written.",
            )
        ladder = load_ladder(store, index, tileset) if options.live_qualities else None
        chooser = QualityChooser(tree, ladder, HORIZON) if ladder else None
        quality = np.zeros(len(tree), np.int64)
        cache = DiskCache(default_cache_folder(), options.cache_bytes)
        reader = ContentReader(
            store, tileset, tree, cache, ladder=ladder, quality=quality if ladder else None
        )

        def read(tile: int, file_quality: int) -> TileArrival:
            quality[tile] = file_quality
            return reader.decode(tile, reader.fetch(tile, lambda count: None))

        link = ReplayLink(read, options.connections)
        session = TilesetSession(
            tree,
            link,
            link,
            options,
            sh_degree=reader.sh_degree,
            report=lambda line: None,  # the recorded flight has reported its failed tiles
            read_model=reader.read_model,
            chooser=chooser,
        )
        try:
            qualities = len(ladder.tiles) if ladder else 1
            return _compare(session, link, log, qualities)
        finally:
            session.close()


def _session_options(record: JsonObject) -> SessionOptions:
    """Return the options of the streaming session that has written an event log."""
    if not isinstance(record.values.get("live_qualities"), bool):
        record.refuse("live_qualities", "true or false")
    return SessionOptions(
        max_error=record.number("max_error", least=0),
        max_splats=record.whole("max_splats", least=1),
        slot_rows=record.whole("slot_rows", least=1),
        upload_budget=record.whole("upload_budget", least=1),
        fade_seconds=record.number("fade_seconds", least=0),
        connections=record.whole("connections", least=1),
        predictor=record.text("predictor"),
        live_qualities=record.values["live_qualities"],
        neural_sessions=record.whole("neural_sessions"),
    )


def _compare(
    session: TilesetSession, link: "ReplayLink", log: Path, qualities: int
) -> tuple[int, FrameDifference | None]:
    """Return the number of equal frames of a replay, and its first difference from the log."""
    count = 0
    for events in read_events(log):
        _require_tiles(events, len(session.tree), qualities, log)
        link.begin(events)
        frame = session.frame(events.frustum)
        for decision, replayed in _decisions(frame).items():
            logged = getattr(events, decision)
            if replayed != logged:
                return count, FrameDifference(
                    frame=count + 1,
                    line=events.line,
                    time=events.time,
                    decision=decision,
                    logged=logged,
                    replayed=replayed,
                )
        count += 1
    if not count:
        raise InputUnreadable("the event log has no frames", where=str(log))
    return count, None


def _decisions(frame: SessionFrame) -> dict[str, object]:
    """Return the decisions of a streaming frame under their names in the event log."""
    return {
        "arrived": tuple((entry.tile, entry.quality) for entry in frame.arrivals if entry.is_last),
        "evicted": frame.evicted,
        "drawn": tuple((entry.tile, entry.fade) for entry in frame.drawn),
        "missing": frame.missing,
    }


def _require_tiles(events: FrameEvents, tiles: int, qualities: int, log: Path) -> None:
    """Raise InputUnreadable if tiles or qualities of a logged frame are not of the tileset."""
    received = [tile for tile, _ in events.received]
    keys = [*events.started, *received, *(tile for tile, *_ in events.failed)]
    checks: tuple[tuple[str, Sequence[int], int], ...] = (
        ("tile", keys, tiles),
        ("quality", [quality for _, quality in events.received], qualities),
    )
    for noun, numbers, count in checks:
        for number in numbers:
            if not 0 <= number < count:
                raise InputUnreadable(
                    f"the event log names {noun} {number}, expected 0 to {count - 1}",
                    where=f"{log}, line {events.line}",
                )


@final
class ReplayLink:
    """Replays an event log as a network and a clock: tiles arrive in the logged frames.

    Args:
        read: Returns the decoded content of a tile at a quality.
        connections: Of the session that wrote the log.
    """

    def __init__(self, read: Callable[[int, int], TileArrival], connections: int) -> None:
        self._read, self._connections = read, connections
        self._requested: set[int] = set()
        self._events: FrameEvents | None = None

    def begin(self, events: FrameEvents) -> None:
        """Set the events of the next frame to replay."""
        self._events = events

    def now(self) -> float:
        """Return the logged time of the replayed frame; 0 before the first one."""
        return self._events.time if self._events else 0.0

    @property
    def free(self) -> int:
        """The number of tile requests that the replayed network link still accepts."""
        return self._connections - len(self._requested)

    def request(self, tile: int) -> None:
        """Record a tile request of the replayed streaming session."""
        self._requested.add(tile)

    def queue(self, tiles: Iterable[int]) -> None:
        """Ignore queued tiles, because the replayed event log says which of them were requested."""

    def take_started(self) -> list[int]:
        """Return the tiles that the logged streaming session requested from its queue."""
        assert self._events is not None
        self._requested |= set(self._events.started)
        self._requested -= {tile for tile, *_ in (*self._events.received, *self._events.failed)}
        return list(self._events.started)

    def progress(self, tile: int) -> float:
        """Return 1 (completely received), so that the planner cancels no request in a replay."""
        del tile
        return 1.0

    def cancel(self, tile: int) -> int:
        """Forget a tile request of the replayed streaming session."""
        self._requested.discard(tile)
        return 0

    def poll(self) -> list[FetchResult[TileArrival]]:
        """Return the tiles that arrived in the replayed frame."""
        assert self._events is not None
        results = [FetchResult(t, self._read(t, q), None) for t, q in self._events.received]
        for tile, message, may_pass in self._events.failed:
            kind = StoreUnavailable if may_pass else TilesetInvalid
            results.append(FetchResult(tile, None, kind(message)))
        self._requested -= {result.tile for result in results}
        return results

    def wait(self, seconds: float) -> None:
        """Return at once: a replayed streaming session waits for no network."""

    def close(self) -> None:
        """Close nothing, because a replayed network link has no connections."""
