"""Writes and reads the event log of a streaming session, a file of JSON lines.

The first line holds the options of the session and a digest of its tiles, each further line the
events of a frame or those of neural tiles.
"""

__all__ = [
    "EventLog",
    "FrameEvents",
    "NeuralEvents",
    "read_events",
    "read_session_record",
    "tree_digest",
]

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Final, final

import numpy as np

from gsgen.contract.errors import InputUnreadable
from gsgen.tiles.errors import StoreUnavailable
from gsgen.tiles.json_values import JsonDict, JsonObject, parse_object
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.streaming.fetch import FetchResult
from gsgen.tiles.streaming.session_frame import SessionFrame, TileArrival

_LOGGED_OPTIONS: Final = (
    "max_error",
    "max_splats",
    "slot_rows",
    "upload_budget",
    "fade_seconds",
    "connections",
    "predictor",
    "live_qualities",
    "neural_sessions",
)  # of a session, on which its decisions depend
_HINT: Final = "Name an event log that `gsgen render` or `gsgen view` wrote with --log."


def tree_digest(tree: TileTree) -> str:
    """Return the SHA-256 of a tileset's tree, geometric errors, splat counts and file URIs."""
    tiles = [
        [
            int(tree.parent[index]),
            tile.geometric_error,
            tile.refine,
            int(tree.splats[index]),
            [content.uri for content in tile.contents],
        ]
        for index, tile in enumerate(tree.tiles)
    ]
    return sha256(json.dumps(tiles).encode()).hexdigest()


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

    Args:
        path: Of the file.
        tree: The tiles.
        options: The fields of the session's ``SessionOptions``.

    Raises:
        InputUnreadable: The file cannot be written.
    """

    def __init__(self, path: Path, tree: TileTree, options: Mapping[str, object]) -> None:
        try:
            self._file = path.open("w", encoding="utf-8")
        except OSError as error:
            raise InputUnreadable(
                f"cannot be written: {error.strerror}",
                where=str(path),
                hint="Choose another --log.",
            ) from error
        logged = {name: options[name] for name in _LOGGED_OPTIONS}
        record = {"session": {"tiles": tree_digest(tree), "options": logged}}
        self._file.write(json.dumps(record) + "\n")

    def frame(
        self,
        time: float,
        frustum: Frustum,
        started: Sequence[int],
        received: Sequence[FetchResult[TileArrival]],
        frame: SessionFrame,
    ) -> None:
        """Write the events of a streaming frame to the log."""
        arrived = [result for result in received if result.error is None]
        event = {
            "t": time,
            "planes": frustum.planes.tolist(),
            "eye": frustum.eye.tolist(),
            "rotation": frustum.rotation.tolist(),
            "focal": frustum.focal,
            "flat": frustum.flat,
            "started": list(started),
            "received": [result.tile for result in arrived],
            "received_qualities": [result.content.quality for result in arrived if result.content],
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
        line: Number of the line in the file, from 1.
        time: Of the frame, in seconds.
        frustum: Of the camera.
        started: Tiles that the link requested by itself since the frame before.
        received: Tiles whose contents had come, and the quality of each.
        failed: Tiles that could not be had: key, message, and whether it may pass.
        drawn: Tiles that were drawn, and their fades.
        arrived: Tiles that were uploaded to their last row, and the quality of each.
        evicted: Tiles that left.
        missing: How many wanted tiles were not resident.
    """

    line: int
    time: float
    frustum: Frustum
    started: tuple[int, ...]
    received: tuple[tuple[int, int], ...]
    failed: tuple[tuple[int, str, bool], ...]
    drawn: tuple[tuple[int, float], ...]
    arrived: tuple[tuple[int, int], ...]
    evicted: tuple[int, ...]
    missing: int


def read_session_record(path: Path) -> JsonObject:
    """Return the first record of an event log: the tree's digest and the session's options.

    Raises:
        InputUnreadable: The file cannot be read, or is not an event log.
    """
    where = f"{path}, line 1, "
    lines = _lines(path)
    if lines and lines[0][:1] == b"{":
        record = parse_object(lines[0], where)
        if "session" in record:
            return record.child("session")
    raise InputUnreadable(
        "the file is not an event log; expected a record of the session in its first line",
        where=str(path),
        hint=_HINT,
    )


def read_events(path: Path) -> Iterator[FrameEvents]:
    """Yield the events of each frame of an event log, without those of neural tiles.

    Raises:
        InputUnreadable: The file cannot be read, or a line is not an event.
    """
    for number, line in enumerate(_lines(path), 1):
        values: JsonDict = parse_object(line, f"{path}, line {number}, ").values
        if "neural" in values or "session" in values:
            continue
        try:
            yield _frame_events(number, values)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputUnreadable(
                f"the line is not a frame of an event log ({error!r:.60})",
                where=f"{path}, line {number}",
            ) from error


def _frame_events(line: int, values: JsonDict) -> FrameEvents:
    return FrameEvents(
        line=line,
        time=float(values["t"]),
        frustum=Frustum(
            planes=np.array(values["planes"], np.float64).reshape(-1, 4),
            eye=np.array(values["eye"], np.float64).reshape(3),
            rotation=np.array(values["rotation"], np.float64).reshape(3, 3),
            focal=float(values["focal"]),
            flat=bool(values["flat"]),
        ),
        started=tuple(map(int, values["started"])),
        received=_pairs(values, "received", "received_qualities"),
        failed=tuple((int(t), str(m), bool(p)) for t, m, p in values["failed"]),
        drawn=tuple((int(tile), float(fade)) for tile, fade in values["drawn"]),
        arrived=_pairs(values, "arrived", "qualities"),
        evicted=tuple(map(int, values["evicted"])),
        missing=int(values["missing"]),
    )


def _pairs(values: JsonDict, tiles: str, qualities: str) -> tuple[tuple[int, int], ...]:
    """Return pairs of a tile and its quality from two arrays of a log line's JSON object."""
    return tuple((int(t), int(q)) for t, q in zip(values[tiles], values[qualities], strict=True))


def _lines(path: Path) -> list[bytes]:
    """Return the lines of an event log."""
    try:
        return path.read_bytes().splitlines()
    except OSError as error:
        raise InputUnreadable(
            f"the event log cannot be read: {error.strerror}", where=str(path), hint=_HINT
        ) from error
