"""Streams a tileset into the renderer: each frame draws the tiles that the camera needs."""

__all__ = ["TilesSource", "open_stream", "recognises"]

import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Final, Literal, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.spec import layout
from gsgen.contract.spec.spherical_harmonics import coefficients
from gsgen.contract.spec.units import format_mebibytes
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import PooledSet, SplatPool
from gsgen.runtime.sources.source import Source, Values
from gsgen.runtime.sources.stream_settings import StreamSettings
from gsgen.tiles.leaves import recognises
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.stores.opening import address_of
from gsgen.tiles.streaming.drawing import FADE_SECONDS
from gsgen.tiles.streaming.session import SessionOptions, open_session
from gsgen.tiles.streaming.session_frame import SessionFrame, StreamingSession

_PATIENCE: Final = 0.2  # seconds between two looks at what arrived


@final
class TilesSource(Source):
    """The tiles of a tileset that the camera needs, within budgets of bytes and Gaussians.

    Args:
        name: Path or address of the tileset.
        session: Chooses, fetches and evicts tiles; it is closed with the source.
        up: Upward direction in the root frame.
        extent: Centre and radius of the root tile's box.
        wait: Most seconds that a frame waits for all tiles of its cut; 0 not to wait.
    """

    def __init__(
        self,
        name: str,
        session: StreamingSession,
        *,
        up: tuple[float, float, float],
        extent: tuple[Float[np.ndarray, "3"], float],
        wait: float,
    ) -> None:
        self.name, self.up = name, up
        self._session, self._wait, self._extent = session, wait, extent
        channels = 3 * coefficients(session.sh_degree)
        rows = session.pool_slots * session.slot_rows
        self._pool = SplatPool(rows, channels, slot_rows=session.slot_rows)
        self.pools = (PooledSet(self._pool),)
        empty = np.zeros((0, layout.ROW), np.float32), np.zeros((0, channels), np.float32)
        self.data = SplatData(*empty, "sh")
        self._camera: Camera | None = None
        self._last: SessionFrame | None = None
        self._changes = 0

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Record the camera of the frame, by which tiles are selected."""
        self._camera = camera

    def finish(self) -> None:
        """Take the tiles that arrived; a waiting source takes all tiles that the camera needs."""
        if self._camera is None:
            return
        frustum = Frustum.from_camera(self._camera)
        deadline = time.monotonic() + self._wait
        frame = self._take(frustum)
        while not frame.is_complete and (left := deadline - time.monotonic()) > 0:
            self._session.wait(min(left, _PATIENCE))
            frame = self._take(frustum)
        if self._wait and not frame.is_complete:
            sys.stderr.write(
                f"gsgen: {self.name}: {frame.missing} tiles did not arrive within "
                f"{self._wait:g} s; coarser ones are drawn\n"
            )

    def _take(self, frustum: Frustum) -> SessionFrame:
        """Upload and evict tiles in the renderer's splat pool, as the streaming session decides."""
        frame = self._session.frame(frustum)
        for tile in frame.evicted:
            self._pool.evict(tile)
        for arrival in frame.arrivals:
            self._pool.insert(arrival.tile, arrival.rows, arrival.appearance, arrival.origin)
        self._pool.draw({drawn.tile: drawn.fade for drawn in frame.drawn})
        is_same = self._last is not None and self._last.drawn == frame.drawn
        self._changes += not (is_same and not frame.arrivals and not frame.evicted)
        self._last = frame
        return frame

    def abandon(self) -> None:
        """Do nothing: tiles that arrive wait for the next frame."""

    @property
    def count(self) -> int:
        """The number of Gaussians in the drawn tiles."""
        return int(self._pool.live[self._pool.fade > 0].sum())

    @property
    def state(self) -> tuple[int, ...]:
        """A counter of the frames in which the drawn tiles changed."""
        return (id(self._pool), self._changes)

    @property
    def follows_camera(self) -> bool:
        """True, since the camera decides which tiles of a tileset are drawn."""
        return True

    @property
    def is_streaming(self) -> bool:
        """Whether the picture still changes under a fixed camera, while tiles arrive or fade."""
        return self._last is None or not self._last.is_complete

    @property
    def statistics(self) -> tuple[tuple[str, str], ...]:
        """The drawn and the missing tiles, the received bytes, and the share of hits."""
        if self._last is None:
            return ()
        metrics = self._session.metrics
        missing = f", {self._last.missing} missing" if self._last.missing else ""
        used = self._pool.slots - self._pool.free_slots
        return (
            ("tiles", f"{len(self._last.drawn)} drawn{missing}"),
            ("pool", f"{100 * used / self._pool.slots:.0f} % of {len(self._pool):,} rows"),
            ("received", f"{format_mebibytes(metrics.bytes)} in {metrics.requests} requests"),
            ("hits", f"{100 * metrics.hit_rate:.0f} %, {metrics.hole_frames} frames with holes"),
        )

    def splats(
        self, sh_degree: int | None, antialias: Literal["classic", "mip"] | None
    ) -> SplatSet:
        """Return an empty splat set, since the tiles' Gaussians are in the splat pool."""
        return SplatSet(self.data)

    def shape(self, name: str) -> tuple[int, ...]:
        """Raise KeyError, since a tileset has no inputs."""
        raise KeyError(name)

    def survey(self, frames: Iterable[tuple[int, Values]]) -> None:
        """Do nothing, since a tileset's extent is the box of the root tile."""

    def close(self) -> None:
        """Cancel all tile requests, and close the tileset's file store."""
        self._session.close()


def open_stream(path: Path, settings: StreamSettings) -> TilesSource:
    """Open a tileset as a source of Gaussians for the renderer.

    Raises:
        TilesetInvalid: The index is wrong.
        ConfigInvalid: A setting is wrong, or an address is given and urllib3 is not installed.
    """
    options = SessionOptions(
        max_error=settings.max_error,
        max_splats=settings.max_splats,
        fade_seconds=0.0 if settings.wait else FADE_SECONDS,
        predictor=settings.predictor,
        cache_bytes=settings.cache_bytes,
        allow_origins=settings.allow_origins,
        log=settings.log,
    )
    session = open_session(path, options)
    tree = session.tree
    up = session.up
    reach = float(np.linalg.norm(np.abs(tree.half_axes[0]).sum(axis=0)))
    return TilesSource(
        address_of(path) or str(path),
        session,
        up=(float(up[0]), float(up[1]), float(up[2])),
        extent=(tree.center[0], reach),
        wait=settings.wait,
    )
