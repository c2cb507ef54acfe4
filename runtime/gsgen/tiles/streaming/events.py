"""Writes and replays the event log of a streaming session, a file of JSON lines."""

__all__ = ["EventLog", "NeuralEvents", "ReplayLink", "read_events"]

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import final

import numpy as np

from gsgen.contract.errors import InputUnreadable
from gsgen.tiles.errors import StoreUnavailable, TilesetInvalid
from gsgen.tiles.json_values import JsonDict, parse_object
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.streaming.fetch import FetchResult
from gsgen.tiles.streaming.session_frame import SessionFrame, TileArrival


@final
@dataclass(slots=True, kw_only=True)
class NeuralEvents:
    """The events of the ONNX generators of neural tiles in one frame.

    Attributes:
        opened: Tiles whose generator was opened.
        closed: Tiles whose generator was closed.
        failed: Tiles that fall back to their splats, and why.
        ran: Tiles whose generator has run, and the number of its Gaussians.
    """

    opened: list[int] = field(default_factory=list)
    closed: list[int] = field(default_factory=list)
    failed: list[tuple[int, str]] = field(default_factory=list)
    ran: list[tuple[int, int]] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.opened or self.closed or self.failed or self.ran)


@final
class EventLog:
    """Writes an event log: a JSON line per frame of time, frustum, downloads and drawn tiles.

    Raises:
        InputUnreadable: The file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("w", encoding="utf-8")
        except OSError as error:
            raise InputUnreadable(
                f"cannot be written: {error.strerror}",
                where=str(path),
                hint="Choose another --log.",
            ) from error

    def frame(
        self,
        time: float,
        frustum: Frustum,
        started: Sequence[int],
        received: Sequence[FetchResult[TileArrival]],
        frame: SessionFrame,
    ) -> None:
        """Write the events of a streaming frame to the log."""
        event = {
            "t": time,
            "planes": frustum.planes.tolist(),
            "eye": frustum.eye.tolist(),
            "rotation": frustum.rotation.tolist(),
            "focal": frustum.focal,
            "flat": frustum.flat,
            "started": list(started),
            "received": [result.tile for result in received if result.error is None],
            "failed": [
                [result.tile, str(result.error), isinstance(result.error, StoreUnavailable)]
                for result in received
                if result.error is not None
            ],
            "arrived": [arrival.tile for arrival in frame.arrivals if arrival.is_last],
            "qualities": [arrival.quality for arrival in frame.arrivals if arrival.is_last],
            "evicted": list(frame.evicted),
            "drawn": [[entry.tile, entry.fade] for entry in frame.drawn],
            "missing": frame.missing,
        }
        self._file.write(json.dumps(event) + "\n")

    def neural(self, time: float, events: NeuralEvents) -> None:
        """Write a frame's neural-tile events as one line of the event log, which replays skip."""
        self._file.write(json.dumps({"t": time, "neural": asdict(events)}) + "\n")

    def close(self) -> None:
        """Close the event log."""
        self._file.close()


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameEvents:
    """The events of one streaming frame: a line of the event log.

    Attributes:
        time: Of the frame, in seconds.
        frustum: Of the camera.
        started: Tiles that the link requested by itself since the frame before.
        received: Tiles whose contents had come.
        failed: Tiles that could not be had: key, message, and whether it may pass.
        drawn: Tiles that were drawn, and their fades.
        arrived: Tiles that were uploaded to their last row.
        evicted: Tiles that left.
    """

    time: float
    frustum: Frustum
    started: tuple[int, ...]
    received: tuple[int, ...]
    failed: tuple[tuple[int, str, bool], ...]
    drawn: tuple[tuple[int, float], ...]
    arrived: tuple[int, ...]
    evicted: tuple[int, ...]


def read_events(path: Path) -> Iterator[FrameEvents]:
    """Yield the events of each frame of an event log, without those of neural tiles.

    Raises:
        InputUnreadable: The file cannot be read, or a line is not an event.
    """
    try:
        lines = path.read_bytes().splitlines()
    except OSError as error:
        raise InputUnreadable(
            f"the event log cannot be read: {error.strerror}",
            where=str(path),
            hint="Name an event log that was written with --log.",
        ) from error
    for number, line in enumerate(lines, 1):
        values: JsonDict = parse_object(line, f"{path}, line {number}, ").values
        if "neural" in values:
            continue
        try:
            yield FrameEvents(
                time=float(values["t"]),
                frustum=Frustum(
                    planes=np.array(values["planes"], np.float64).reshape(-1, 4),
                    eye=np.array(values["eye"], np.float64).reshape(3),
                    rotation=np.array(values["rotation"], np.float64).reshape(3, 3),
                    focal=float(values["focal"]),
                    flat=bool(values["flat"]),
                ),
                started=tuple(map(int, values.get("started", ()))),
                received=tuple(map(int, values["received"])),
                failed=tuple((int(t), str(m), bool(p)) for t, m, p in values["failed"]),
                drawn=tuple((int(tile), float(fade)) for tile, fade in values["drawn"]),
                arrived=tuple(map(int, values["arrived"])),
                evicted=tuple(map(int, values["evicted"])),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputUnreadable(
                f"the line is not a frame of an event log ({error!r:.60})",
                where=f"{path}, line {number}",
            ) from error


@final
class ReplayLink:
    """Replays an event log as a network and a clock: tiles arrive in the logged frames.

    Args:
        read: Returns the decoded content of a tile.
        connections: Of the session that wrote the log.
    """

    def __init__(self, read: Callable[[int], TileArrival], connections: int) -> None:
        self._read, self._connections = read, connections
        self._requested: set[int] = set()
        self._events: FrameEvents | None = None

    def begin(self, events: FrameEvents) -> None:
        """Set the events of the next frame to replay."""
        self._events = events

    def now(self) -> float:
        """Return the logged time of the replayed frame."""
        assert self._events is not None
        return self._events.time

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
        self._requested -= {*self._events.received, *(tile for tile, *_ in self._events.failed)}
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
        results = [FetchResult(t, self._read(t), None) for t in self._events.received]
        for tile, message, may_pass in self._events.failed:
            kind = StoreUnavailable if may_pass else TilesetInvalid
            results.append(FetchResult(tile, None, kind(message)))
        self._requested -= {result.tile for result in results}
        return results

    def wait(self, seconds: float) -> None:
        """Return at once: a replayed streaming session waits for no network."""

    def close(self) -> None:
        """Close nothing, because a replayed network link has no connections."""
