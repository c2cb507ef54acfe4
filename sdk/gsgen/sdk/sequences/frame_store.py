"""Keeps the frames of a sequence in a temporary file, from which all frames of some rows are read.

A frame is written once, as it arrives. The encoder then reads blocks of rows over all frames, so
that its memory depends on the number of frames, not on that of Gaussians.
"""

__all__ = [
    "BASE_CHANNELS",
    "COLOR",
    "FrameStore",
    "cholesky_factors",
    "covariance_of",
    "higher_terms",
]

import tempfile
from collections.abc import Iterator
from typing import IO, Final

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64

from gsgen.contract.spec import layout
from gsgen.sdk.exporting.constant_generator import ConstantRows

# Bytes of a block of rows over all frames, in float32.
_BLOCK_BYTES: Final = 64 << 20

# A variance below this share of the trace is raised to it: rounding in float32 hides smaller ones.
_MIN_VARIANCE_SHARE: Final = 1e-7
_MIN_TRACE: Final = 1e-30

BASE_CHANNELS: Final = 3
"""Channels of RGB, or of the constant term of SH."""
COLUMNS: Final = layout.ROW_LENGTH + BASE_CHANNELS
"""Numbers of a stored row."""
COLOR: Final = slice(layout.ROW_LENGTH, COLUMNS)
"""The columns of the base colour."""


def cholesky_factors(covariance: Float[np.ndarray, "n 6"]) -> Float64[np.ndarray, "n 6"]:
    """Return the Cholesky factors L of covariances Σ = L Lᵀ, as l00 l10 l20 l11 l21 l22.

    The diagonal of L is positive. Pivots are at least 10⁻⁷ of the trace of Σ.
    """
    xx, xy, xz, yy, yz, zz = covariance.astype(np.float64).T
    floor = _MIN_VARIANCE_SHARE * np.maximum(xx + yy + zz, _MIN_TRACE)
    l00 = np.sqrt(np.maximum(xx, floor))
    l10, l20 = xy / l00, xz / l00
    l11 = np.sqrt(np.maximum(yy - l10 * l10, floor))
    l21 = (yz - l10 * l20) / l11
    l22 = np.sqrt(np.maximum(zz - l20 * l20 - l21 * l21, floor))
    return np.stack([l00, l10, l20, l11, l21, l22], axis=1)


def covariance_of(factors: Float64[np.ndarray, "6 n"]) -> Float64[np.ndarray, "6 n"]:
    """Return xx xy xz yy yz zz of Σ = L Lᵀ; ``factors`` are l00 l10 l20 l11 l21 l22."""
    l00, l10, l20, l11, l21, l22 = factors
    return np.stack(
        [
            *(l00 * l00, l00 * l10, l00 * l20, l10 * l10 + l11 * l11),
            *(l10 * l20 + l11 * l21, l20 * l20 + l21 * l21 + l22 * l22),
        ]
    )


def higher_terms(appearance: Float[np.ndarray, "n c"]) -> Float32[np.ndarray, "n k"]:
    """Return the SH coefficients beyond the constant term; none of RGB."""
    return np.asarray(appearance[:, BASE_CHANNELS:], np.float32)


class FrameStore:
    """Frames of packed Gaussians in a temporary file, with Cholesky factors for covariances.

    Columns of the stored rows are x y z, opacity, l00 l10 l20 l11 l21 l22, and the base colour of
    three channels. The file is removed when the store is closed.

    Args:
        first: The first frame, whose SH coefficients stand for those of all frames.
    """

    def __init__(self, first: ConstantRows) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile(prefix="gsgen-frames-")  # noqa: SIM115
        self.restart(first)

    def restart(self, first: ConstantRows) -> None:
        """Forget all frames; the next ones have the rows of ``first``."""
        self.rows, self.frames = len(first.rows), 0
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)
        self.largest_change = 0.0  # of SH coefficients beyond the constant term
        self._higher_terms = higher_terms(first.appearance)
        self._file.truncate(0)

    def append(self, rows: Float[np.ndarray, "n 10"], appearance: Float[np.ndarray, "n c"]) -> None:
        """Add the packed Gaussians and the appearance of the next frame."""
        stored = np.concatenate([rows, appearance[:, :BASE_CHANNELS]], axis=1, dtype=np.float32)
        stored[:, layout.COVARIANCE] = cholesky_factors(rows[:, layout.COVARIANCE])
        visible = stored[stored[:, layout.OPACITY] >= layout.CULL_OPACITY, layout.POSITION]
        if len(visible):
            self.low = np.minimum(self.low, visible.min(axis=0))
            self.high = np.maximum(self.high, visible.max(axis=0))
        change = np.abs(higher_terms(appearance) - self._higher_terms).max(initial=0.0)
        self.largest_change = max(self.largest_change, float(change))
        self._file.seek(0, 2)
        self._file.write(stored.tobytes())
        self.frames += 1

    def block(self, start: int, stop: int) -> Float32[np.ndarray, "f n 13"]:
        """Return the rows from ``start`` to ``stop`` of all frames."""
        self._file.flush()
        block = np.empty((self.frames, stop - start, COLUMNS), np.float32)
        row_bytes = COLUMNS * 4
        for frame in range(self.frames):
            self._file.seek((frame * self.rows + start) * row_bytes)
            block[frame] = np.frombuffer(
                self._file.read((stop - start) * row_bytes), np.float32
            ).reshape(-1, COLUMNS)
        return block

    def blocks(
        self, selected: Int64[np.ndarray, " m"] | None = None
    ) -> Iterator[tuple[slice, Float32[np.ndarray, "f n 13"]]]:
        """Yield the selected rows of all frames, some at a time, and their places among these.

        Args:
            selected: Row numbers in ascending order; all rows if absent.
        """
        size = max(1, _BLOCK_BYTES // (self.frames * COLUMNS * 4))
        for start in range(0, self.rows, size):
            stop = min(start + size, self.rows)
            if selected is None:
                yield slice(start, stop), self.block(start, stop)
                continue
            first, last = np.searchsorted(selected, [start, stop])
            if first < last:
                yield (
                    slice(int(first), int(last)),
                    self.block(start, stop)[:, selected[first:last] - start],
                )

    def close(self) -> None:
        """Remove the temporary file."""
        self._file.close()
