"""Writes the event log of a streaming session: a JSON line per frame, and per neural-tile event."""

__all__ = ["EventLog", "NeuralEvents", "print_line"]

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import final

from gsgen.contract._safe_text import printable
from gsgen.contract.errors import ConfigInvalid
from gsgen.tiles.errors import StoreUnavailable
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

    Args:
        path: Of the file.

    Raises:
        ConfigInvalid: The file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("w", encoding="utf-8")
        except OSError as error:
            raise ConfigInvalid(
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
        arrived_tiles = [result for result in received if result.error is None]
        event = {
            "t": time,
            "planes": frustum.planes.tolist(),
            "eye": frustum.eye.tolist(),
            "rotation": frustum.rotation.tolist(),
            "focal": frustum.focal,
            "flat": frustum.flat,
            "started": list(started),
            "received": [result.tile for result in arrived_tiles],
            "received_qualities": [
                result.content.quality for result in arrived_tiles if result.content
            ],
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
        """Write a frame's neural-tile events as one line of the event log."""
        self._file.write(json.dumps({"t": time, "neural": asdict(events)}) + "\n")

    def close(self) -> None:
        """Close the event log."""
        self._file.close()


def print_line(line: str) -> None:
    """Print a line about a tile to standard error."""
    sys.stderr.write(f"gsgen: {printable(line)}\n")
