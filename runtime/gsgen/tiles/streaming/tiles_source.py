"""Streams a tileset into the renderer: each frame draws the tiles that the camera needs."""

__all__ = ["TilesSource", "open_stream"]

import math
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.spherical_harmonics import coefficients
from gsgen.contract.spec.units import format_mebibytes
from gsgen.formats.shared.origins import Origin
from gsgen.formats.shared.splats import NO_ORIGIN
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import PooledSplatSet, SplatPool
from gsgen.runtime.scene.transforms import identity, moved
from gsgen.runtime.sources.placed_source import local_camera
from gsgen.runtime.sources.source import Source, SourceShortfall, Values
from gsgen.runtime.sources.stream_settings import StreamSettings
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.stores.opening import address_of
from gsgen.tiles.streaming.drawing import FADE_SECONDS
from gsgen.tiles.streaming.events import print_line
from gsgen.tiles.streaming.fetch import RETRY_AFTER
from gsgen.tiles.streaming.neural_tiles import NeuralTiles
from gsgen.tiles.streaming.session import (
    RUNS_PER_SECOND,
    SessionOptions,
    TilesetSession,
    open_session,
)
from gsgen.tiles.streaming.session_frame import SessionFrame

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels

_POLL_SECONDS: Final = 0.2  # seconds between two looks at what arrived
_RETRY_SECONDS: Final = 2.0  # where frames wait for all tiles
_TIME_INPUT: Final = "time"


@final
class TilesSource(Source):
    """The tiles of a tileset that the camera needs, within budgets of bytes and Gaussians.

    Neural tiles with an input ``time`` give the source this input, over the range of all of them.

    Args:
        name: Path or address of the tileset.
        session: Chooses, fetches and evicts tiles; it is closed with the source.
        up: Upward direction in the root frame.
        extent: Centre and radius of the root tile's box.
        wait: Most seconds that a frame waits for all tiles of its cut, and for the generators of
            its neural tiles; 0 not to wait.
        neural: The generators of neural tiles, which the session closes; None for none.
        origin: The point of the scene that is 0, 0, 0 in the root frame. Cameras, and the extent
            of the source, are in the coordinates of the scene.
    """

    def __init__(
        self,
        name: str,
        session: TilesetSession,
        *,
        up: tuple[float, float, float],
        extent: tuple[Float[np.ndarray, "3"], float],
        wait: float,
        neural: NeuralTiles | None = None,
        origin: Origin = NO_ORIGIN,
    ) -> None:
        self.name, self.up = name, up
        self._neural_tiles = neural
        if neural and (span := neural.time_range):
            self.inputs = (
                Input(name=_TIME_INPUT, role=_TIME_INPUT, shape=(1,), range=span, default=span[0]),
            )
        self._values: dict[str, object] = {}
        self._session, self._waits_for_tiles = session, wait
        self._extent = extent[0] + origin, extent[1]
        self._scene_transform = moved(identity(), origin)
        channels = 3 * coefficients(session.sh_degree)
        rows = session.pool_slots * session.slot_rows
        self._pool = SplatPool(rows, channels, slot_rows=session.slot_rows)
        self.pools = (PooledSplatSet(self._pool, self._scene_transform),)
        empty = np.zeros((0, layout.ROW_LENGTH), np.float32), np.zeros((0, channels), np.float32)
        self.data = SplatData(*empty, "sh", origin=origin)
        self._camera: Camera | None = None
        self._last_session_frame: SessionFrame | None = None
        self._drawing_change_count = 0
        self._absent_tiles: set[int] = set()
        self._late_tiles_note = ""  # what the first frame lacks that did not get all in time

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Record the frame's camera, which selects the tiles, and the models' input values."""
        self._camera = None if camera is None else local_camera(camera, self._scene_transform)
        self._values |= values

    def expect(self, cameras: Sequence[Camera]) -> None:
        """Prefetch the tiles of frames to come, while the network is idle."""
        local = [local_camera(camera, self._scene_transform) for camera in cameras]
        self._session.expect([Frustum.from_camera(camera) for camera in local])

    def finish(self) -> None:
        """Receive the tiles that arrived; if a waiting time is set, wait for all needed tiles."""
        if self._camera is None:
            return
        frustum = Frustum.from_camera(self._camera)
        deadline = time.monotonic() + self._waits_for_tiles
        frame = self._take_frame(frustum, self._camera)
        while (self.is_streaming or frame.retried) and (left := deadline - time.monotonic()) > 0:
            if frame.is_complete and not frame.retried and self._neural_tiles:
                self._neural_tiles.wait(min(left, _POLL_SECONDS))
            else:
                self._session.wait(min(left, _POLL_SECONDS))
            frame = self._take_frame(frustum, self._camera)
        if self._waits_for_tiles:
            self._note_shortfall(frame)

    def _note_shortfall(self, frame: SessionFrame) -> None:
        """Keep what a frame lacks that was waited for."""
        self._absent_tiles.update(frame.absent_tiles)
        late = ""
        if frame.missing:
            late = f"{frame.missing} did not arrive"
        elif not frame.is_complete:
            late = "finer files did not arrive"
        elif pending_tiles := self._pending_generators:
            late = f"{pending_tiles} generators did not finish"
        if late and not self._late_tiles_note:
            self._late_tiles_note = f"{late} within {self._waits_for_tiles:g} s"

    @property
    def shortfall(self) -> SourceShortfall | None:
        """The tiles that the frames so far lack, of those that they waited for."""
        cause = self._session.first_failure if self._absent_tiles else ""
        cause = cause or self._late_tiles_note
        return SourceShortfall(self.name, len(self._absent_tiles), cause) if cause else None

    def _take_frame(self, frustum: Frustum, camera: Camera) -> SessionFrame:
        """Upload and evict tiles in GPU memory (splat pool), as the streaming session decides."""
        frame = self._session.frame(frustum)
        for tile in frame.evicted:
            self._pool.evict(tile)
        for arrival in frame.arrivals:
            rows, appearance = arrival.rows[arrival.part], arrival.appearance[arrival.part]
            content = arrival.tile, rows, appearance, arrival.origin
            if arrival.first_row or (arrival.is_upgrade and not arrival.is_last):
                self._pool.extend(*content, first_row=arrival.first_row)
            elif arrival.is_upgrade:
                self._pool.rewrite(*content)
            else:
                reserved_count = max(arrival.reserved_rows, len(arrival.rows))
                self._pool.insert(*content, reserved_rows=reserved_count)
        has_rewritten = self._rewrite_rows(frame, camera)
        self._pool.draw({drawn.tile: drawn.fade for drawn in frame.drawn})
        last = self._last_session_frame
        is_same_cut = last is not None and last.drawn == frame.drawn
        has_changed = frame.arrivals or frame.evicted or has_rewritten or not is_same_cut
        self._drawing_change_count += bool(has_changed)
        self._last_session_frame = frame
        return frame

    def _rewrite_rows(self, frame: SessionFrame, camera: Camera) -> bool:
        """Write new Gaussians of tiles' ONNX generators into the tiles' slots of the splat pool."""
        if self._neural_tiles is None:
            return False
        for tile in frame.evicted:
            self._neural_tiles.evict(tile)
        for arrival in frame.arrivals:
            if arrival.is_last:
                self._neural_tiles.arrive(arrival)
        updates = self._neural_tiles.frame(
            camera,
            self._values,
            [drawn.tile for drawn in frame.drawn],
            uploaded=sum(arrival.upload_bytes for arrival in frame.arrivals),
            is_complete=frame.missing == 0,
        )
        for update in updates:
            rows, appearance = update.rows[update.part], update.appearance[update.part]
            content = update.tile, rows, appearance, update.origin
            if update.first_row or not update.is_last:
                self._pool.stage(*content, first_row=update.first_row, count=len(update.rows))
            else:
                self._pool.rewrite(*content)
        return bool(updates)

    @property
    def _pending_generators(self) -> int:
        return len(self._neural_tiles.pending_tiles) if self._neural_tiles else 0

    def interrupt(self) -> None:
        """Stop the runs of tiles' ONNX generators; these tiles then draw their stored splats."""
        if self._neural_tiles:
            self._neural_tiles.interrupt()

    def abandon(self) -> None:
        """Discard no tile request: tiles that arrive after this frame are drawn in the next one."""

    @property
    def count(self) -> int:
        """The number of Gaussians in the drawn tiles."""
        return int(self._pool.live[self._pool.fade > 0].sum())

    @property
    def state(self) -> tuple[int, ...]:
        """A counter of the frames in which the drawn tiles changed."""
        return (id(self._pool), self._drawing_change_count)

    @property
    def follows_camera(self) -> bool:
        """Whether frames depend on the camera: always, since it decides which tiles are drawn."""
        return True

    @property
    def is_streaming(self) -> bool:
        """Whether the picture still changes under a fixed camera, while tiles arrive or fade."""
        is_complete = self._last_session_frame is not None and self._last_session_frame.is_complete
        return not is_complete or self._pending_generators > 0

    @property
    def statistics(self) -> tuple[tuple[str, str], ...]:
        """Statistics for display: drawn and missing tiles, received bytes, hit rate, open models."""
        if self._last_session_frame is None:
            return ()
        metrics = self._session.metrics
        missing = (
            f", {self._last_session_frame.missing} missing"
            if self._last_session_frame.missing
            else ""
        )
        used = self._pool.slots - self._pool.free_slots
        rows = (
            ("tiles", f"{len(self._last_session_frame.drawn)} drawn{missing}"),
            ("pool", f"{100 * used / self._pool.slots:.0f} % of {len(self._pool):,} rows"),
            ("received", f"{format_mebibytes(metrics.bytes)} in {metrics.requests} requests"),
            ("hits", f"{100 * metrics.hit_rate:.0f} %, {metrics.hole_frames} frames with holes"),
        )
        if self._neural_tiles is None:
            return rows
        neural = self._neural_tiles
        models = format_mebibytes(neural.bytes)
        text = f"{len(neural.open_tiles)} open, {neural.runs} runs, models of {models}"
        return (*rows, ("generators", text))

    def splats(
        self, sh_degree: int | None, antialias: Literal["classic", "mip"] | None
    ) -> SplatSet:
        """Return an empty splat set, since the tiles' Gaussians are in the GPU's splat pool."""
        return SplatSet(self.data)

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of the input ``time`` of a tileset's generators, which have no other input."""
        if name != _TIME_INPUT or not self.inputs:
            raise KeyError(name)
        return (1,)

    def survey(self, frames: Iterable[tuple[int, Values]]) -> None:
        """Do nothing: a tileset's extent is the box of its root tile, known without any frame."""

    def close(self) -> None:
        """Cancel all tile requests, and close the tileset's file store."""
        self._session.close()


def _ignore_line(line: str) -> None:
    del line


def open_stream(
    path: Path,
    provider: str = "cpu",
    settings: StreamSettings | None = None,
    confined: "ConfinedModels | None" = None,
) -> TilesSource:
    """Open a tileset as a source of Gaussians for the renderer.

    Args:
        path: The tileset's index, folder, archive or address.
        provider: ONNX Runtime's execution provider for the generators of neural tiles.
        settings: How tiles are chosen, fetched and kept.
        confined: Runs the models in child processes with limits; None runs them in this process.

    Raises:
        TilesetInvalid: The index is wrong.
        ConfigInvalid: A setting is wrong.
    """
    settings = settings or StreamSettings()
    options = SessionOptions(
        max_error=settings.max_error,
        max_splats=settings.max_splats,
        fade_seconds=0.0 if settings.wait else FADE_SECONDS,
        upload_budget=settings.upload_bytes,
        connections=settings.connections,
        predictor=settings.predictor,
        cache_bytes=settings.cache_bytes,
        allow_origins=settings.allow_origins,
        log=settings.log,
        neural_sessions=settings.neural_sessions,
        provider=provider,
        confined=confined,
        runs_per_second=math.inf if settings.wait else RUNS_PER_SECOND,
        retry_seconds=_RETRY_SECONDS if settings.wait else RETRY_AFTER,
    )
    # Frames that wait for their tiles count those that fail, see `TilesSource.shortfall`.
    session = open_session(
        path, options, report=_ignore_line if settings.wait else None, report_generators=print_line
    )
    tree = session.tree
    up = session.up
    reach = float(np.linalg.norm(np.abs(tree.half_axes[0]).sum(axis=0)))
    return TilesSource(
        address_of(path) or str(path),
        session,
        up=(float(up[0]), float(up[1]), float(up[2])),
        extent=(tree.center[0], reach),
        wait=settings.wait,
        neural=session.neural,
        origin=session.origin,
    )
