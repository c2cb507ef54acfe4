"""Streams a tileset: takes a camera each frame, and returns tiles to upload and to draw."""

__all__ = ["RUNS_PER_SECOND", "SessionOptions", "TilesetSession", "open_session"]

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.contract.spec.spherical_harmonics import coefficients
from gsgen.formats.glb.container import Container
from gsgen.formats.shared.origins import Origin
from gsgen.formats.shared.splats import NO_ORIGIN, Splats
from gsgen.runtime.scene.splat_pool import pool_row_bytes
from gsgen.tiles.loading.quality_ladder import TileQualities, quality_ladder
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.prediction.poses import Pose, matrix_quaternion
from gsgen.tiles.prediction.predictor import Predictor
from gsgen.tiles.prediction.predictors import predictor_maker
from gsgen.tiles.prediction.prefetch import HorizonPrefetch, PathPrefetch
from gsgen.tiles.selection.cut import TileCut, cut_tree
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.selection.request_order import finer_file_order
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.stores.store import Store
from gsgen.tiles.streaming.clock import Clock, SystemClock
from gsgen.tiles.streaming.contents import ContentReader
from gsgen.tiles.streaming.disk_cache import DiskCache, default_cache_folder
from gsgen.tiles.streaming.drawing import TileFades, drawable_tiles
from gsgen.tiles.streaming.events import EventLog, print_line
from gsgen.tiles.streaming.fetch import FailedTiles, FetchLink, FetchResult
from gsgen.tiles.streaming.generator_opening import ModelReader
from gsgen.tiles.streaming.metrics import MetricsRecorder, StreamingMetrics
from gsgen.tiles.streaming.neural_tiles import NeuralTiles
from gsgen.tiles.streaming.planner import RequestPlanner
from gsgen.tiles.streaming.residency import ResidentTiles
from gsgen.tiles.streaming.session_frame import (
    RUNS_PER_SECOND,
    DrawnTile,
    SessionFrame,
    SessionOptions,
    TileArrival,
)

_ERROR_STEP: Final = 2**0.25  # step of the error while a cut does not fit the pool
_MAX_ERROR_STEPS: Final = 80
_QUEUED_FRAMES: Final = 2  # whose uploads are requested ahead
_MAX_PENDING_UPLOADS: Final = 64  # decoded tiles that wait for their upload


def open_session(
    source: str | Path,
    options: SessionOptions | None = None,
    *,
    report: Callable[[str], None] | None = None,
    report_generators: Callable[[str], None] | None = None,
) -> "TilesetSession":
    """Open a tileset for streaming.

    Args:
        source: ``tileset.json``, its folder, a ``.3tz`` archive, or an address.
        options: How it is streamed.
        report: Receives a line for each tile that cannot be had; stderr where absent.
        report_generators: Receives a line for each generator that cannot run; as ``report``.

    Raises:
        TilesetInvalid: The index is wrong.
    """
    options = options or SessionOptions()
    make_predictor = predictor_maker(options.predictor, options.confined)  # fails at once
    store, index = open_store(source, allow_origins=options.allow_origins)
    try:
        tileset = load_tileset(store, index, name=str(source))
        tree = TileTree.of_tileset(tileset, store)
        cache = None
        if options.cache_bytes:
            folder = options.cache_folder or default_cache_folder()
            cache = DiskCache(folder, options.cache_bytes)
        ladder = quality_ladder(tileset)
        qualities = TileQualities(ladder) if ladder else None
        if qualities:
            tree = replace(tree, size=qualities.coarsest_size.copy())
        reader = ContentReader(store, tileset, tree, cache, qualities=qualities)
        link: FetchLink[list[Container | Splats], TileArrival] = FetchLink(
            reader.fetch, reader.decode, reader.size, options.connections
        )
        return TilesetSession(
            tree,
            link,
            SystemClock(),
            options,
            sh_degree=reader.sh_degree,
            report=report or print_line,
            report_generators=report_generators,
            store=store,
            up=tileset.up,
            origin=tileset.origin,
            read_model=reader.read_model,
            qualities=qualities,
            make_predictor=make_predictor,
        )
    except BaseException:
        store.close()
        raise


@final
class TilesetSession:
    """A streaming session of a tileset: each frame uploads and draws the tiles it needs.

    Attributes:
        tree: The tiles; keys are their indices.
        up: Upward direction in the root frame.
        sh_degree: Of all arrivals.
        slot_rows: Rows of a slot.
        pool_slots: Slots of the pool.
        upload_budget: Bytes of arrivals in a frame.
        neural: The generators of neural tiles; None if there are none, or none may run.

    Args:
        tree: The tiles.
        link: Fetches and decodes them.
        clock: Of frames and fades.
        options: How the tileset is streamed.
        sh_degree: Of all arrivals.
        report: Receives a line for each tile that cannot be had.
        report_generators: Receives a line for each generator that cannot run; None for ``report``.
        store: Closed with the session.
        up: Upward direction in the root frame; that of splat files if None.
        read_model: Reads the model of a neural tile; None to draw the splats of these tiles.
        qualities: The files of tiles at several qualities; None for a single quality.
        make_predictor: Makes the predictor of camera poses; None for that of the options.
    """

    def __init__(
        self,
        tree: TileTree,
        link: FetchLink[Any, TileArrival],
        clock: Clock,
        options: SessionOptions,
        *,
        sh_degree: int,
        report: Callable[[str], None] = print_line,
        report_generators: Callable[[str], None] | None = None,
        store: Store | None = None,
        up: Float64[np.ndarray, " 3"] | None = None,
        origin: Origin = NO_ORIGIN,
        read_model: ModelReader | None = None,
        qualities: TileQualities | None = None,
        make_predictor: Callable[[], Predictor] | None = None,
    ) -> None:
        self._tile_qualities = qualities
        self.up = np.array([0.0, -1.0, 0.0]) if up is None else up
        self.origin = origin
        self.tree, self.sh_degree, self.slot_rows = tree, sh_degree, options.slot_rows
        self.upload_budget = options.upload_budget
        self.pool_slots = -(-options.max_splats // options.slot_rows)
        self._options, self._fetch_link, self._clock = options, link, clock
        self._report, self._store, self._report_generators = report, store, report_generators
        self._recorder = MetricsRecorder(tree.parent, tree.size)
        self._frustum: Frustum | None = None
        make_predictor = make_predictor or predictor_maker(options.predictor, options.confined)
        prefetch = HorizonPrefetch(tree, make_predictor(), self._frustum_at, options.max_error)
        self._prefetch = prefetch
        self._planner = RequestPlanner(tree, link, self._recorder, prefetch)
        self._log = EventLog(options.log) if options.log else None
        self.neural = self._neural_tiles(read_model)
        self._reserved_row_count = self._reserved_rows()
        self._slots: Int64[np.ndarray, " n"] = -(
            -np.maximum(tree.splats, self._reserved_row_count) // options.slot_rows
        )
        if tree.is_counted:  # a pool need not hold more than the whole tileset
            self.pool_slots = min(self.pool_slots, max(1, int(self._slots.sum())))
        self._resident_tiles = ResidentTiles(tree, self._slots, self.pool_slots)
        self._tile_fades = TileFades(tree, options.fade_seconds)
        self._is_contentless = np.array([not tile.contents for tile in tree.tiles])
        self._pending_arrivals: dict[int, TileArrival] = {}
        self._partial_upload: TileArrival | None = None  # whose rows are not all uploaded
        self._failed_tiles = FailedTiles(len(tree), options.retry_seconds)
        self._started_requests: list[int] = []

    def _neural_tiles(self, read_model: ModelReader | None) -> NeuralTiles | None:
        options = self._options
        is_neural = any(tile.neural for tile in self.tree.tiles)
        if read_model is None or options.neural_sessions < 1 or not is_neural:
            return None
        return NeuralTiles(
            self.tree,
            read_model,
            self._clock,
            options,
            sh_degree=self.sh_degree,
            max_rows=self.pool_slots * self.slot_rows,
            report=self._report_generators or self._report,
            log=self._log,
        )

    def _reserved_rows(self) -> Int64[np.ndarray, " n"]:
        """Return how many splat pool rows each tile reserves; 0 for tiles without a generator."""
        reserved_counts = np.zeros(len(self.tree), np.int64)
        if self.neural:
            for tile in self.neural.tiles:
                reserved_counts[tile] = self.neural.reserved_rows(tile)
        return reserved_counts

    @property
    def metrics(self) -> StreamingMetrics:
        """The streaming metrics of all frames so far."""
        return self._recorder.summary()

    @property
    def first_failure(self) -> str:
        """The error of the first tile that could not be had, in one line; empty without any."""
        return self._failed_tiles.first_cause

    @property
    def resident(self) -> Bool[np.ndarray, " n"]:
        """The mask of the tiles that are in the renderer's GPU memory (splat pool)."""
        return self._resident_tiles.resident

    def frame(self, frustum: Frustum) -> SessionFrame:
        """Return the tiles to upload and to draw now, without waiting for the network."""
        time = self._clock.now()
        self._frustum = frustum
        # 1. Take what arrived, and select the tiles that this camera needs.
        received = self._receive_tiles(time)
        cut = self._cut_within_budget(frustum)
        needed = cut.seen | (self._tile_fades.values > 0)
        if self._partial_upload:
            needed[self._partial_upload.tile] = True
        # 2. Upload arrivals; tiles that are not needed leave for them.
        self._resident_tiles.frame(time, needed)
        evicted, arrivals = self._upload(time, cut)
        is_failed = self._failed_tiles.mask(time)
        is_available = self._resident_tiles.resident | self._is_contentless
        if self._partial_upload and not self._partial_upload.is_upgrade:
            is_available[self._partial_upload.tile] = False
        # 3. Request what is missing.
        self._recorder.frame(time, cut, is_available)
        self._request(time, cut, is_available | is_failed)
        # 4. Draw the tiles that are there in place of those that are not.
        drawn = drawable_tiles(self.tree, cut, is_available)
        self._tile_fades.frame(time, drawn, cut.seen)
        opacity_factors = self._tile_fades.values
        missing = int((cut.selected & ~is_available & ~is_failed).sum())
        frame = SessionFrame(
            evicted=evicted,
            arrivals=arrivals,
            drawn=tuple(
                DrawnTile(tile, float(opacity_factors[tile]))
                for tile in np.flatnonzero((opacity_factors > 0) & ~self._is_contentless).tolist()
            ),
            missing=missing,
            retried=int((cut.selected & is_failed & self._failed_tiles.is_awaited).sum()),
            absent_tiles=tuple(np.flatnonzero(cut.selected & (is_failed | ~is_available)).tolist()),
            is_complete=missing == 0
            and self._tile_fades.is_settled
            and (
                self._tile_qualities is None
                or self._tile_qualities.are_finest(cut.selected & is_available & ~is_failed)
            ),
        )
        if self._log:
            self._log.frame(time, frustum, self._started_requests, received, frame)
        return frame

    def expect(self, frustums: Sequence[Frustum]) -> None:
        """Prefetch along the cameras of frames to come, which will be drawn in this order."""
        error, capacity = self._options.max_error, self.pool_slots
        path = PathPrefetch(self.tree, frustums, error, slots=self._slots, capacity=capacity)
        self._planner.prefetch(path)

    def wait(self, seconds: float) -> None:
        """Sleep until a requested tile arrives or fails; return at once if tiles await upload."""
        if not (self._pending_arrivals or self._partial_upload):
            self._fetch_link.wait(seconds)

    def close(self) -> None:
        """Cancel all tile requests, and close the file store and the event log."""
        self._fetch_link.close()
        if self.neural:
            self.neural.close()
        if self._store:
            self._store.close()
        if self._log:
            self._log.close()

    def _frustum_at(self, pose: Pose) -> Frustum:
        assert self._frustum is not None
        return self._frustum.moved(pose.position, pose.quaternion)

    def _receive_tiles(self, time: float) -> list[FetchResult[TileArrival]]:
        """Take the tiles that arrived over the network; report the tiles that failed."""
        self._fetch_link.queue(())  # the link begins no request while this frame plans
        results = list(self._fetch_link.poll())
        # After the poll: no result lacks its request.
        self._started_requests = self._fetch_link.take_started()
        for tile in self._started_requests:
            self._planner.begin(tile)
        for result in results:
            if result.content is not None:
                if self._tile_qualities:
                    size = self._tile_qualities.size(result.tile, result.content.quality)
                    self.tree.size[result.tile] = size
                self._planner.arrive(result.tile, time)
                self._pending_arrivals[result.tile] = result.content
                continue
            self._planner.fail(result.tile)
            assert result.error is not None
            self._report(self._failed_tiles.add(result.tile, result.error, time))
        return results

    def _cut_within_budget(self, frustum: Frustum) -> TileCut:
        """Select tiles as fine as the GPU memory can hold, together with all their ancestors."""

        def is_within_budget(cut: TileCut) -> bool:
            return int(self._slots[cut.seen].sum()) <= self.pool_slots

        error = self._options.max_error
        for _ in range(_MAX_ERROR_STEPS):
            cut = cut_tree(self.tree, frustum, error)
            if is_within_budget(cut):
                return cut
            error *= _ERROR_STEP
        # Tiles with the camera inside have an infinite error: fewer levels fit.
        for level in range(len(self.tree.rows_of_level) - 1, -1, -1):
            cut = cut_tree(self.tree, frustum, error, max_level=level)
            if is_within_budget(cut):
                break
        return cut

    def _upload(self, time: float, cut: TileCut) -> tuple[tuple[int, ...], tuple[TileArrival, ...]]:
        """Upload decoded tiles within a frame's budget: visible tiles first, coarse before fine."""
        level, error, seen = self.tree.level, cut.error, cut.seen
        order = sorted(self._pending_arrivals, key=lambda t: (not seen[t], level[t], -error[t], t))
        evicted: list[int] = []
        arrivals: list[TileArrival] = []
        remaining_bytes = self.upload_budget
        if self._partial_upload:
            arrivals.append(self._next_upload(self._partial_upload))
            remaining_bytes -= arrivals[0].upload_bytes
        for tile in order:
            part = self._pending_arrivals[tile].next_part(
                remaining_bytes, self.slot_rows, first_row=0
            )
            if self._partial_upload or (arrivals and part.upload_bytes > remaining_bytes):
                break
            del self._pending_arrivals[tile]
            arrival = replace(
                part,
                reserved_rows=int(self._reserved_row_count[tile]),
                is_upgrade=bool(self._resident_tiles.resident[tile]),
            )
            evicted_tiles = self._admit_arrival(arrival, time)
            if evicted_tiles is None:
                continue  # no room beside the drawn tiles: it is asked for again later
            evicted += evicted_tiles
            arrivals.append(arrival)
            remaining_bytes -= arrival.upload_bytes
            self._partial_upload = None if arrival.is_last else arrival
        for tile in [tile for tile in reversed(order) if tile in self._pending_arrivals][
            :-_MAX_PENDING_UPLOADS
        ]:
            del self._pending_arrivals[tile]
        return tuple(evicted), tuple(arrivals)

    def _next_upload(self, arrival: TileArrival) -> TileArrival:
        """Return the part of a tile that follows the part which the last frame uploaded."""
        part = arrival.next_part(self.upload_budget, self.slot_rows, first_row=arrival.end_row)
        self._partial_upload = None if part.is_last else part
        return part

    def _admit_arrival(self, arrival: TileArrival, time: float) -> tuple[int, ...] | None:
        """Reserve GPU memory for a tile; return the evicted tiles, or None if there is no room."""
        tile = arrival.tile
        if not arrival.is_upgrade:
            # The metadata of foreign tilesets do not count splats: the estimate may be too low.
            needed = -(-len(arrival.rows) // self.slot_rows)
            self._slots[tile] = max(int(self._slots[tile]), needed)
        evicted_tiles = self._resident_tiles.admit_tile(tile, time)
        if evicted_tiles is None:
            return None
        self._resident_tiles.protect(tile)  # no other arrival of the frame displaces it
        for evicted_tile in evicted_tiles:
            self._tile_fades.drop(evicted_tile)
        if self._tile_qualities:
            for evicted_tile in evicted_tiles:
                self._tile_qualities.gpu_quality[evicted_tile] = -1
                self.tree.size[evicted_tile] = self._tile_qualities.coarsest_size[evicted_tile]
            self._tile_qualities.gpu_quality[tile] = arrival.quality
        return evicted_tiles

    def _request(self, time: float, cut: TileCut, loaded: Bool[np.ndarray, " n"]) -> None:
        """Request the tiles that the current frame needs."""
        assert self._frustum is not None
        loaded = loaded.copy()
        loaded[list(self._pending_arrivals)] = True
        if self._partial_upload:
            loaded[self._partial_upload.tile] = True
        # What would not fit the pool is not asked for.
        loaded |= self._slots > self.pool_slots
        eye, focal = self._frustum.eye, self._frustum.focal
        pose = Pose(time, eye, matrix_quaternion(self._frustum.rotation.T), focal)
        self._planner.frame(pose, cut, loaded)
        self._planner.fill(loaded, self._finer_files(time, cut))
        self._fetch_link.queue(self._next_requests(loaded))

    def _next_requests(self, loaded: Bool[np.ndarray, " n"]) -> list[int]:
        """Return the next tiles to request, as many as the next frames can upload.

        Without them, a renderer of few frames a second would request few tiles a second.
        """
        row_bytes = pool_row_bytes(3 * coefficients(self.sh_degree))
        pending_tiles_in_order = [*self._planner.in_flight, *self._pending_arrivals]
        remaining_bytes = _QUEUED_FRAMES * self.upload_budget - row_bytes * int(
            self.tree.splats[pending_tiles_in_order].sum()
        )
        missing = self._planner.missing(loaded)
        uploads = np.cumsum(row_bytes * self.tree.splats[missing])
        return missing[
            : min(
                int(np.searchsorted(uploads, remaining_bytes, side="right")), _MAX_PENDING_UPLOADS
            )
        ]

    def _finer_files(self, time: float, cut: TileCut) -> list[int]:
        """Return the drawn tiles whose finest file is to be requested, in order of request."""
        if self._tile_qualities is None:
            return []
        assert self._frustum is not None
        drawn = cut.selected & self._resident_tiles.resident & ~self._failed_tiles.mask(time)
        drawn[
            [
                *self._pending_arrivals,
                *([self._partial_upload.tile] if self._partial_upload else []),
            ]
        ] = False
        ladder, gpu_quality = self._tile_qualities.ladder, self._tile_qualities.gpu_quality
        order = finer_file_order(self.tree, ladder, gpu_quality, drawn, self._frustum.eye)
        return [int(tile) for tile in order]
