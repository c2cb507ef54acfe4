"""The options of a streaming session, and its result in one frame: tiles that come, go, are drawn.

The session decides, the renderer obeys. Each frame, in this order:

1. The renderer calls ``TilesetSession.frame`` with its camera.
2. It frees the slots of every tile of ``evicted``, and of no other.
3. It uploads the part of every arrival of ``arrivals``. Their bytes are within the upload budget,
   and their slots within the pool, as the session counts them: ⌈rows / slot_rows⌉ for a whole tile,
   or ⌈reserved_rows / slot_rows⌉ if that is more. An upgrade takes the slots that the tile has.
4. It draws the tiles of ``drawn``, with opacities multiplied by ``fade``, and no other.

A tile is resident from its arrival to its eviction. Drawn tiles are resident. A tile whose bytes
exceed what the budget leaves arrives in parts of whole slots, in the frames that follow each other;
it has its slots from the first part on, and is resident with the last. Keys are indices of
tiles in depth-first order and never change; a tile that was evicted may arrive again.
"""

__all__ = ["RUNS_PER_SECOND", "DrawnTile", "SessionFrame", "SessionOptions", "TileArrival"]

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

import numpy as np
from jaxtyping import Float32, Float64

from gsgen.runtime.scene.splat_pool import SLOT_ROWS, pool_row_bytes
from gsgen.tiles.streaming.drawing import FADE_SECONDS
from gsgen.tiles.streaming.fetch import RETRY_AFTER

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels

UPLOAD_BUDGET: Final = 4 << 20
RUNS_PER_SECOND: Final = 25.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """The options of a streaming session.

    Attributes:
        max_error: Screen-space error above which tiles are refined, in pixels.
        max_splats: Rows of the pool, in whole slots.
        slot_rows: Rows of a slot.
        upload_budget: Bytes of arrivals in a frame.
        fade_seconds: Of a cross-fade; 0 for pictures that do not depend on time.
        connections: Requests at once.
        predictor: A name or a file, see :func:`predictor_maker`.
        cache_bytes: Cap of the disk cache; 0 for none.
        cache_folder: Of the disk cache; the user's where absent.
        allow_origins: Other origins that redirects may lead to.
        log: File of events as JSON lines; None for none.
        neural_sessions: Most generators of neural tiles that are open at once; 0 for none.
        provider: Execution provider of ONNX Runtime for these generators.
        confined: Runs models in child processes with limits; None runs them in this process.
        runs_per_second: Most runs of all generators in a second; infinite to wait for each run.
        retry_seconds: Until a tile that a server did not give is requested again, at first.
    """

    max_error: float = 16.0
    max_splats: int = 2_000_000
    slot_rows: int = SLOT_ROWS
    upload_budget: int = UPLOAD_BUDGET
    fade_seconds: float = FADE_SECONDS
    connections: int = 6
    predictor: str = "constant-velocity"
    cache_bytes: int = 2 << 30
    cache_folder: Path | None = None
    allow_origins: tuple[str, ...] = ()
    log: Path | None = None
    neural_sessions: int = 4
    provider: str = "cpu"
    confined: "ConfinedModels | None" = None
    runs_per_second: float = RUNS_PER_SECOND
    retry_seconds: float = RETRY_AFTER


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TileArrival:
    """The decoded splats of a tile, ready to be copied to GPU memory (slots of the splat pool).

    Attributes:
        tile: Key of the tile.
        rows: ``x y z opacity xx xy xz yy yz zz`` in the root tile's frame, float32, [n, 10], in
            Morton order; x, y, z are relative to ``origin``.
        appearance: SH coefficients of degree 0 up, three channels each, float32, [n, c]; c is
            the same for all tiles of a session.
        origin: In the root tile's frame, float64.
        reserved_rows: Rows that the slots of the tile must hold; more than those of ``rows`` for
            a neural tile, whose generator writes into the same slots.
        quality: Index of the file's quality in the ladder; 0 is the finest.
        is_upgrade: Whether the tile is resident, and these rows replace its own.
        first_row: First row of the part that is uploaded now.
        end_row: One past its last row.
    """

    tile: int
    rows: Float32[np.ndarray, "n 10"] = field(repr=False)
    appearance: Float32[np.ndarray, "n c"] = field(repr=False)
    origin: Float64[np.ndarray, " 3"]
    reserved_rows: int = 0
    quality: int = 0
    is_upgrade: bool = False
    first_row: int = 0
    end_row: int = -1

    def __post_init__(self) -> None:
        if self.end_row < 0:
            object.__setattr__(self, "end_row", len(self.rows))

    def next_part(self, max_bytes: int, slot_rows: int, *, first_row: int) -> "TileArrival":
        """Return the next part of a tile to upload: about ``max_bytes`` bytes from row ``first_row``."""
        slots = max(1, max_bytes // (slot_rows * pool_row_bytes(self.appearance.shape[1])))
        end_row = min(len(self.rows), first_row + slots * slot_rows)
        return replace(self, first_row=first_row, end_row=end_row)

    @property
    def is_last(self) -> bool:
        """Whether the whole tile is in GPU memory after this part is uploaded."""
        return self.end_row == len(self.rows)

    @property
    def part(self) -> slice:
        """The rows of the tile that are uploaded in this frame."""
        return slice(self.first_row, self.end_row)

    @property
    def upload_bytes(self) -> int:
        """The number of bytes that this frame writes to GPU memory for a part of a tile."""
        return (self.end_row - self.first_row) * pool_row_bytes(self.appearance.shape[1])


@final
@dataclass(frozen=True, slots=True)
class DrawnTile:
    """A tile in GPU memory that is drawn in a frame.

    Attributes:
        tile: Key of the tile.
        fade: Factor on the opacity of its splats, above 0, at most 1.
    """

    tile: int
    fade: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SessionFrame:
    """The changes of a streaming session in one frame, and the tiles to draw.

    Attributes:
        evicted: Keys of tiles whose slots are free now; in none of the frames to come are they
            drawn before they arrive again.
        arrivals: Tiles to upload, whole or in part, in this order.
        drawn: Tiles to draw; ascending keys.
        missing: How many tiles the camera wants that are not resident, and may still come.
        retried: How many tiles the camera wants whose requests failed, and are soon repeated.
        absent_tiles: Keys of the tiles that the camera wants and that are not resident at their finest,
            those that cannot be had too.
        is_complete: Whether everything that the camera wants is resident, at the finest quality,
            and drawn without a fade; tiles that cannot be had do not count.
    """

    evicted: tuple[int, ...]
    arrivals: tuple[TileArrival, ...]
    drawn: tuple[DrawnTile, ...]
    missing: int
    retried: int = 0
    absent_tiles: tuple[int, ...] = ()
    is_complete: bool
