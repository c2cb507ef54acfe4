"""Chooses which tile files to fetch first and at which quality, by the measured network rate."""

__all__ = ["QualityChooser"]

from collections import deque
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.quality_ladder import QualityLadder
from gsgen.tiles.selection.cut import Cut
from gsgen.tiles.selection.joint_choice import choose_jointly
from gsgen.tiles.selection.seen_tiles import SeenTiles
from gsgen.tiles.selection.tile_tree import TileTree

_WINDOW: Final = 4.0  # seconds over which the rate is measured
_CHOICE_SECONDS: Final = 0.1  # for which a choice holds


@final
class QualityChooser:
    """Chooses levels of detail and file qualities of missing tiles together, by worth per byte.

    The budget is the measured rate times the horizon, and the Gaussians in GPU memory. A tile that
    the choice leaves out is fetched last and at the coarsest quality, and so are all tiles until a
    rate is known. Finer files of the tiles in view follow while nothing is missing.

    Attributes:
        quality: Of the file that each tile is asked for next: an index of the ladder.
        held: Of the file of each resident tile; −1 for other tiles.
        certificate: Most worth that the last choice lacks, as a share of the best choice.

    Args:
        tree: The tiles.
        ladder: Their files.
        horizon: Seconds within which the missing tiles should arrive.
    """

    def __init__(self, tree: TileTree, ladder: QualityLadder, horizon: float) -> None:
        self._tree, self._ladder, self._horizon = tree, ladder, horizon
        coarsest = len(ladder.worth) - 1
        self.quality: Int64[np.ndarray, " n"] = np.full(len(tree), coarsest)
        self.held: Int64[np.ndarray, " n"] = np.full(len(tree), -1)
        self.certificate = 0.0
        self._received: deque[tuple[float, float, int]] = deque()  # time, busy seconds, bytes
        self._time: float | None = None
        self._chosen_at: float | None = None
        self._first: Bool[np.ndarray, " n"] = np.zeros(len(tree), bool)

    @property
    def rate(self) -> float | None:
        """The bytes received per second while requests ran; None before the first response."""
        busy = sum(seconds for _, seconds, _ in self._received)
        total = sum(size for _, _, size in self._received)
        return total / busy if busy > 0 and total else None

    def size(self, tile: int, quality: int) -> int:
        """Return the number of bytes of a tile's content file at a quality."""
        return int(self._ladder.size[tile, quality])

    def sizes(self, rows: Int64[np.ndarray, " m"]) -> Float64[np.ndarray, " m"]:
        """Return, for each given tile, the size in bytes of the file to request next."""
        return np.asarray(self._ladder.size[rows, self.quality[rows]])

    def is_finest(self, tiles: Bool[np.ndarray, " n"]) -> bool:
        """Return whether all loaded files of the given tiles have the finest quality."""
        return not bool((tiles & (self.held > 0)).any())

    def observe(self, time: float, received: int, *, busy: bool) -> None:
        """Record the bytes of tiles that arrived since the last frame.

        Args:
            time: Of the frame, in seconds.
            received: Bytes.
            busy: Whether requests were under way.
        """
        seconds = 0.0 if self._time is None or not busy else time - self._time
        self._time = time
        self._received.append((time, seconds, received))
        while self._received[0][0] < time - _WINDOW and len(self._received) > 1:
            self._received.popleft()

    def choose(
        self,
        time: float,
        eye: Float64[np.ndarray, " 3"],
        cut: Cut,
        there: Int64[np.ndarray, " n"],
        *,
        dead: Bool[np.ndarray, " n"],
        max_splats: int,
    ) -> Bool[np.ndarray, " n"]:
        """Choose levels of detail and file qualities of the missing tiles that a camera sees.

        A choice holds for a tenth of a second.

        Args:
            time: Of the frame, in seconds.
            eye: Of the camera.
            cut: Of the camera.
            there: Quality of each tile's file that is there or on its way; −1 for none.
            dead: Tiles whose files cannot be had.
            max_splats: The most Gaussians in GPU memory.

        Returns:
            The tiles to request before others: the chosen ones, and those above them.
        """
        if self._chosen_at is not None and time - self._chosen_at < _CHOICE_SECONDS:
            return self._first
        self._chosen_at, self._first = time, np.zeros(len(self._tree), bool)
        missing = cut.seen & (there < 0) & ~dead
        quality = np.where(missing, len(self._ladder.worth) - 1, self.quality)
        rate = self.rate
        if rate is not None and missing.any():
            weight = self._weight(eye, np.flatnonzero(cut.seen))
            seen = SeenTiles.of_cut(self._tree, self._ladder, cut, weight, there, dead)
            choice = choose_jointly(
                seen.options, seen.splats, byte_budget=rate * self._horizon, splat_budget=max_splats
            )
            if choice is not None:
                self.certificate = choice.certificate
                is_drawn = (choice.option >= 0) & (choice.option < len(self._ladder.worth))
                tiles, option = seen.tile[is_drawn], choice.option[is_drawn]
                quality[tiles] = np.where(missing[tiles], option, quality[tiles])
                self._first[tiles] = True
                self._first = self._tree.with_ancestors(self._first)
        self.quality[:] = quality  # in place, as the threads that fetch files read it
        return self._first

    def upgrade(self, eye: Float64[np.ndarray, " 3"], drawn: Bool[np.ndarray, " n"]) -> int | None:
        """Return the drawn tile whose finest file adds most value per byte; it is requested next.

        A finer file is fetched whole, and replaces the rows of the coarser one.
        """
        rows = np.flatnonzero(drawn & (self.held > 0))
        if not len(rows):
            return None
        gain = self._ladder.worth[0] - self._ladder.worth[self.held[rows]]
        gain = gain * self._weight(eye, rows) / self._ladder.size[rows, 0]
        tile = int(rows[np.argmax(gain)])
        self.quality[tile] = 0
        return tile

    def _weight(
        self, eye: Float64[np.ndarray, " 3"], rows: Int64[np.ndarray, " m"]
    ) -> Float64[np.ndarray, " m"]:
        """Return each tile's share of the picture: the squared apparent size, at most 1."""
        reach = np.linalg.norm(self._tree.half_axes[rows], axis=(1, 2))
        distance = np.linalg.norm(self._tree.center[rows] - eye, axis=1)
        return np.asarray(np.minimum(reach / np.maximum(distance, 1e-9), 1.0) ** 2)
