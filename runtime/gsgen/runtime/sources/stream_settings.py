"""Settings of scene sources that stream what a camera needs, such as tilesets."""

__all__ = ["StreamOpener", "StreamSettings"]

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, final

if TYPE_CHECKING:
    from gsgen.runtime.sources.source import Source


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StreamSettings:
    """Settings of streaming a tileset: screen-space error, budgets, disk cache and prediction.

    Attributes:
        max_error: Screen-space error above which tiles are refined, in pixels.
        max_splats: Most Gaussians in GPU memory at once.
        cache_bytes: Most bytes of files in the disk cache; 0 for no cache.
        upload_bytes: Most bytes of arriving tiles that a frame uploads.
        connections: Most requests at once.
        predictor: Name of a predictor of camera paths, or its ONNX file.
        log: File of events as JSON lines; None for none.
        allow_origins: Other origins that redirects of a server may lead to.
        neural_sessions: Most generators of neural tiles that are open at once; 0 for none.
        wait: Most seconds that a frame waits for all tiles that its camera needs; 0 to draw what
            is there, as a window does, with cross-fades.
    """

    max_error: float = 16.0
    max_splats: int = 2_000_000
    cache_bytes: int = 2 << 30
    upload_bytes: int = 4 << 20
    connections: int = 6
    predictor: str = "constant-velocity"
    log: Path | None = None
    allow_origins: tuple[str, ...] = ()
    neural_sessions: int = 4
    wait: float = 30.0


StreamOpener = Callable[[Path, str], "Source"]
"""Opens a tileset for an execution provider of ONNX Runtime, as gsgen.tiles.open_stream does."""
