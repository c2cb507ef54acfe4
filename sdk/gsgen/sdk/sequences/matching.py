"""Matches the Gaussians of frames whose rows do not correspond, so that each has one row.

Between two neighbouring frames, pairs of near Gaussians that look alike are accepted in the order
of their distance; a Gaussian without a partner dies, and one that is new is born. A row holds one
Gaussian from birth to death, and is invisible before and after.
"""

__all__ = ["FramesUnmatched", "TrackedFrames", "match_rows", "track_frames"]

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float32, Float64, Int64

from gsgen.contract.spec import layout
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.exporting.constant_generator import ConstantRows
from gsgen.sdk.sequences.frame_store import BASE_CHANNELS, cholesky_factors

_CANDIDATES: Final = 8  # near Gaussians of the next frame that are compared
_ROUNDS: Final = 8  # of proposals; further ones pair few
# Differences that count as one, and the largest distance of a pair: centres and factors differ in
# units of the Gaussian's size.
_COLOR_UNIT, _OPACITY_UNIT = 0.1, 0.25
_MAX_DISTANCE: Final = 3.0
# The unit of centres, in sizes, as long as the motion is not known.
_SEARCH_SIZES: Final = 8.0
# More rows than this, as a multiple of the largest frame's, are not worth a clip: so many, or half of
# the rows new in each frame.
_MAX_ROW_FACTOR: Final = 4.0
_MAX_NEW_SHARE: Final = 0.5

_Reader = Callable[[int], ConstantRows]


class FramesUnmatched(GeneratorInvalid):
    """Raised if so few Gaussians of neighbouring frames match that they are not worth a clip."""


def match_rows(first: ConstantRows, second: ConstantRows) -> Int64[np.ndarray, " n"]:
    """Return the row of the second frame that each row of the first one becomes, or −1.

    Pairs that are alike, though far from each other, tell how Gaussians near them move. The final
    pairs are near each other after that motion.
    """
    from scipy.spatial import KDTree

    if not len(first.rows) or not len(second.rows):
        return np.full(len(first.rows), -1)
    start, end = (_features(frame) for frame in (first, second))
    size = np.sqrt(np.square(start[:, layout.COVARIANCE]).sum(axis=1) / 3)
    tree = KDTree(end[:, layout.POSITION])
    centre = start[:, layout.POSITION].copy()
    pairs = _pairs(start, end, tree, _SEARCH_SIZES * size)
    if (pairs >= 0).sum() >= _CANDIDATES:
        known = np.flatnonzero(pairs >= 0)
        offset = end[pairs[known], layout.POSITION] - centre[known]
        _, neighbours = KDTree(centre[known]).query(centre, k=_CANDIDATES)
        start[:, layout.POSITION] = centre + np.median(offset[neighbours], axis=1)
    return _pairs(start, end, tree, size)


def _pairs(
    start: Float64[np.ndarray, "n 13"],
    end: Float64[np.ndarray, "m 13"],
    tree: Any,
    reach: Float64[np.ndarray, " n"],
) -> Int64[np.ndarray, " n"]:
    """Return the partner of each row, or −1; ``reach`` is the unit of differences of centres."""
    partner = np.full(len(start), -1)
    count = min(_CANDIDATES, len(end))
    _, candidates = tree.query(start[:, layout.POSITION], k=count)
    candidates = candidates.reshape(len(start), count)
    distance = _distances(start, end, candidates, reach)
    distance[distance > _MAX_DISTANCE] = np.inf
    for _ in range(_ROUNDS):
        # Each free Gaussian proposes to its best candidate, which accepts the best proposal.
        best = distance.argmin(axis=1)
        rows = np.flatnonzero(np.isfinite(distance[np.arange(len(best)), best]) & (partner < 0))
        if not len(rows):
            break
        rows = rows[np.argsort(distance[rows, best[rows]], kind="stable")]
        chosen = candidates[rows, best[rows]]
        _, winners = np.unique(chosen, return_index=True)
        partner[rows[winners]] = chosen[winners]
        taken = np.zeros(len(end), bool)
        taken[partner[partner >= 0]] = True
        distance[taken[candidates]] = np.inf
    return partner


def _features(frame: ConstantRows) -> Float64[np.ndarray, "n 13"]:
    """Return centre, opacity, Cholesky factors and base colour of each row."""
    rows = frame.rows.astype(np.float64)
    rows[:, layout.COVARIANCE] = cholesky_factors(frame.rows[:, layout.COVARIANCE])
    return np.concatenate([rows, frame.appearance[:, :BASE_CHANNELS]], axis=1)


def _distances(
    start: Float64[np.ndarray, "n 13"],
    end: Float64[np.ndarray, "m 13"],
    candidates: Int64[np.ndarray, "n k"],
    reach: Float64[np.ndarray, " n"],
) -> Float64[np.ndarray, "n k"]:
    """Return the distance of each row of the first frame to its candidates."""
    size = np.sqrt(np.square(start[:, layout.COVARIANCE]).sum(axis=1) / 3)
    units = np.concatenate(
        [
            np.repeat(reach[:, None], 3, axis=1),
            np.full((len(start), 1), _OPACITY_UNIT),
            np.repeat(size[:, None], 6, axis=1),
            np.full((len(start), BASE_CHANNELS), _COLOR_UNIT),
        ],
        axis=1,
    )
    squares = np.zeros(candidates.shape)
    for column in range(start.shape[1]):
        change = end[candidates, column] - start[:, column : column + 1]
        squares += np.square(change / np.maximum(units[:, column : column + 1], 1e-12))
    return np.asarray(np.sqrt(squares))


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrames:
    """Frames whose rows correspond after matching.

    Attributes:
        read: Reads a frame of the source.
        tracks: The row of the clip of each row of each frame.
        births: The rows of the clip as they are born.
        largest: Gaussians of the largest frame.
    """

    read: _Reader
    tracks: tuple[Int64[np.ndarray, " n"], ...]
    births: ConstantRows
    largest: int

    def frame(
        self, number: int, previous: Float32[np.ndarray, "t 10"]
    ) -> tuple[Float32[np.ndarray, "t 10"], Float32[np.ndarray, "t c"]]:
        """Return rows and appearance of a frame: rows that are not alive stay as in the last one."""
        source, tracks = self.read(number), self.tracks[number]
        rows, appearance = previous.copy(), self.births.appearance.copy()
        rows[:, layout.OPACITY] = 0
        rows[tracks], appearance[tracks] = source.rows, source.appearance
        return rows, appearance


def track_frames(read: _Reader, count: int, progress: Callable[[str], None]) -> TrackedFrames:
    """Match all neighbouring frames, and return frames whose rows correspond.

    Raises:
        FramesUnmatched: So few Gaussians match that the clip would have too many rows.
    """
    previous = read(0)
    tracks = [np.arange(len(previous.rows))]
    total, largest = len(previous.rows), len(previous.rows)
    rows, appearance = [previous.rows], [previous.appearance]
    for number in range(1, count):
        progress(f"matching frame {number + 1} of {count}")
        frame = read(number)
        partner = match_rows(previous, frame)
        track = np.full(len(frame.rows), -1)
        track[partner[partner >= 0]] = tracks[-1][partner >= 0]
        born = np.flatnonzero(track < 0)
        track[born] = np.arange(total, total + len(born))
        rows.append(frame.rows[born])
        appearance.append(frame.appearance[born])
        tracks.append(track)
        total, largest = total + len(born), max(largest, len(frame.rows))
        if total > min(_MAX_ROW_FACTOR, 1 + _MAX_NEW_SHARE * (count - 1)) * largest:
            message = (
                f"rows of the frames do not correspond, and too few match: {total:,} different "
                f"Gaussians in the first {number + 1} of {count} frames of up to {largest:,}"
            )
            hint = "A scene file plays such frames one by one: -o clip.json."
            raise FramesUnmatched(message, where="FRAMES", hint=hint)
        previous = frame
    births = replace(previous, rows=np.concatenate(rows), appearance=np.concatenate(appearance))
    return TrackedFrames(read, tuple(tracks), births, largest)
