"""Runs ONNX generators that tiles hold, whose Gaussians replace the tiles' stored splats.

Of the drawn neural tiles, the largest ones in view have a generator, at most as many as there are
sessions. Each frame, in this order:

1. Take the generators that were opened and the runs that ended.
2. Close generators of tiles that are no longer among the largest.
3. Open one more generator, while nothing else is missing: read the model, check its digest, and
   validate it against the contract and the tile's declaration.
4. Begin runs for tiles whose inputs changed, the longest waiting first, up to a rate.
5. Return new rows of tiles, within the bytes that a frame may upload. A tile that may exceed them
   has twice its slots: parts of the new rows go beside the drawn ones, and are drawn once whole.

A tile shows its own splats until its generator has run, and again when the generator is closed or
breaks a promise: then a line names the tile, and the model is not run again.
"""

__all__ = ["NeuralTiles"]

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from dataclasses import dataclass, field
from typing import Any, NamedTuple, final

import numpy as np

from gsgen.contract.errors import GsgenError, HostProcessFailed
from gsgen.contract.spec.fields.roles import CAMERA_ROLES
from gsgen.contract.spec.spherical_harmonics import coefficients
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.splat_pool import pool_row_bytes
from gsgen.runtime.sources.generator_worker import FrameDelta, GeneratorWorker
from gsgen.runtime.sources.placed_source import local_camera
from gsgen.tiles.errors import Fault, StoreUnavailable, TilesetInvalid
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.streaming.clock import Clock
from gsgen.tiles.streaming.events import EventLog, NeuralEvents
from gsgen.tiles.streaming.fetch import RETRY_AFTER
from gsgen.tiles.streaming.generator_opening import GeneratorOpener, ModelReader
from gsgen.tiles.streaming.generator_rows import tile_rows
from gsgen.tiles.streaming.session_frame import SessionOptions, TileArrival


class _RunInputs(NamedTuple):
    """The varying inputs of an ONNX generator's run, to compare with those of the last run.

    Attributes:
        camera: View matrix and intrinsics; None for a generator without a camera.
        time: In seconds; None for a generator without a time.
    """

    camera: tuple[bytes, tuple[object, ...]] | None
    time: float | None


@final
@dataclass(slots=True, eq=False, kw_only=True)
class _Generator:
    """An ONNX generator that a tile holds, opened in a session of ONNX Runtime.

    Attributes:
        worker: Runs the model on a thread.
        pending: The run that was begun.
        started_inputs: Inputs of that run.
        drawn_inputs: Inputs of the run that ``result`` came of.
        result: Latest rows, in the root frame.
        last_run: Time of the last run's begin.
        last_drawn: Time at which the tile was last drawn.
    """

    worker: GeneratorWorker
    pending: "Future[FrameDelta] | None" = None
    started_inputs: _RunInputs | None = None
    drawn_inputs: _RunInputs | None = None
    result: TileArrival | None = None
    last_run: float = -np.inf
    last_drawn: float = -np.inf
    rows: np.ndarray | None = field(default=None, repr=False)
    appearance: np.ndarray | None = field(default=None, repr=False)


@final
class NeuralTiles:
    """The ONNX generators that tiles of a tileset hold, run within time and upload budgets.

    Attributes:
        time_range: First and last time of all neural tiles; None without an input ``time``.
        bytes: Bytes of models received.
        runs: Number of runs that ended.

    Args:
        tree: The tiles.
        read_model: Reads the model of a tile; called on a thread.
        clock: Of the rate of runs.
        options: The budgets, and what runs the models.
        sh_degree: Of the splat pool.
        max_rows: Rows of the splat pool; a tile that declares more draws its splats.
        report: Receives a line for each generator that cannot be run.
        log: Receives events; None for none.
    """

    def __init__(
        self,
        tree: TileTree,
        read_model: ModelReader,
        clock: Clock,
        options: SessionOptions,
        *,
        sh_degree: int,
        max_rows: int,
        report: Callable[[str], None],
        log: EventLog | None = None,
    ) -> None:
        self._tree, self._read_model, self._clock = tree, read_model, clock
        self._options, self._sh_degree, self._max_rows = options, sh_degree, max_rows
        self._report, self._log = report, log
        self._neural_tiles_by_index = {
            index: tile.neural
            for index, tile in enumerate(tree.tiles)
            if tile.neural and tile.contents
        }
        for tile, neural in list(self._neural_tiles_by_index.items()):
            if neural.splats_max > max_rows:
                del self._neural_tiles_by_index[tile]
                report(
                    f"{neural.location}.splats_max: {neural.splats_max:,}; expected at most "
                    f"{max_rows:,}, the budget of Gaussians; the tile's splats are drawn"
                )
        spans = [
            neural.time_range
            for neural in self._neural_tiles_by_index.values()
            if neural.time_range
        ]
        self.time_range = (
            (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None
        )
        self.bytes = self.runs = 0
        self._contents: dict[int, TileArrival] = {}  # of resident neural tiles
        self._pool_contents: dict[int, TileArrival] = {}  # what the slots of each of them hold
        self._uploads: dict[int, tuple[TileArrival, int]] = {}  # in parts; rows that came so far
        self._open_generators: dict[int, _Generator] = {}
        self._loading_generators: dict[int, Future[tuple[GeneratorWorker, int]]] = {}
        self._retry_at: dict[int, float] = {}
        self._pending_tiles: tuple[int, ...] = ()
        self._run_tokens, self._token_time = 1.0, clock.now()
        self._events = NeuralEvents()
        self._opener = GeneratorOpener(tree, read_model, options.provider, options.confined)
        self._loader = ThreadPoolExecutor(1, thread_name_prefix="gsgen neural tiles")

    @property
    def tiles(self) -> tuple[int, ...]:
        """The tiles whose ONNX generators may run: those whose Gaussians fit in the splat pool."""
        return tuple(self._neural_tiles_by_index)

    def reserved_rows(self, tile: int) -> int:
        """Return how many splat pool rows a tile reserves: twice as many for partial uploads."""
        splats_max, slot_rows = (
            self._neural_tiles_by_index[tile].splats_max,
            self._options.slot_rows,
        )
        max_splats = max(splats_max, int(self._tree.splats[tile]) if self._tree.is_counted else 0)
        slots = -(-max_splats // slot_rows)
        row_bytes = pool_row_bytes(3 * coefficients(self._sh_degree))
        has_parts = slots > 1 and max_splats * row_bytes > self._options.upload_budget
        doubled_rows = 2 * slots * slot_rows
        return doubled_rows if has_parts and doubled_rows <= self._max_rows else splats_max

    @property
    def open_tiles(self) -> tuple[int, ...]:
        """The tiles whose ONNX generators are open, in ascending order."""
        return tuple(sorted(self._open_generators))

    @property
    def pending_tiles(self) -> tuple[int, ...]:
        """The tiles whose ONNX generators have not yet run with the last frame's inputs."""
        return self._pending_tiles

    def arrive(self, arrival: TileArrival) -> None:
        """Record that the stored splats of a tile with an ONNX generator are in the splat pool."""
        if arrival.tile in self._neural_tiles_by_index:
            self._contents[arrival.tile] = self._pool_contents[arrival.tile] = arrival
            self._uploads.pop(arrival.tile, None)

    def evict(self, tile: int) -> None:
        """Forget the splats of a neural tile after its eviction from the splat pool."""
        self._contents.pop(tile, None)
        self._pool_contents.pop(tile, None)
        self._uploads.pop(tile, None)

    def frame(
        self,
        camera: Camera,
        values: Mapping[str, object],
        drawn: Sequence[int],
        *,
        uploaded: int,
        is_complete: bool,
    ) -> list[TileArrival]:
        """Open and run ONNX generators; return the Gaussians that replace rows of their tiles.

        Args:
            camera: In the root frame.
            values: Input values by role, such as ``time``.
            drawn: Keys of the drawn tiles.
            uploaded: Bytes of arrivals in this frame; new rows get what the budget leaves, and
                a tile that is larger than the budget is uploaded alone.
            is_complete: Whether all splats that the camera needs are there, so that models may
                be read.
        """
        time = self._clock.now()
        self._collect_results(time)
        tiles = self._largest_in_view(
            camera, [tile for tile in drawn if tile in self._contents], time
        )
        inputs = {tile: self._inputs(tile, camera, values) for tile in tiles}
        self._close_unused_generators(tiles, time)
        if is_complete:
            self._load_generators(tiles)
        self._run_generators(inputs, camera, time)
        updates = self._updates(uploaded)
        self._pending_tiles = tuple(t for t in tiles if not self._is_run_up_to_date(t, inputs[t]))
        if self._log and self._events:
            self._log.neural(time, self._events)
        self._events = NeuralEvents()
        return updates

    def wait(self, seconds: float) -> None:
        """Sleep until an ONNX generator is open or a model run ends, for a limited time."""
        pending: list[Future[Any]] = [*self._loading_generators.values()]
        pending += [entry.pending for entry in self._open_generators.values() if entry.pending]
        if pending:
            wait_for(pending, timeout=seconds, return_when=FIRST_COMPLETED)

    def interrupt(self) -> None:
        """Stop all pending runs of ONNX generators, which then fail."""
        for entry in self._open_generators.values():
            entry.worker.interrupt()

    def close(self) -> None:
        """Stop all runs of ONNX generators, and release these models."""
        self.interrupt()
        for load in self._loading_generators.values():
            load.cancel()
        self._loader.shutdown(cancel_futures=True)
        for load in self._loading_generators.values():
            if not load.cancelled() and load.exception() is None:
                load.result()[0].close()
        for entry in self._open_generators.values():
            entry.worker.close()
        self._loading_generators, self._open_generators = {}, {}

    # ---- 1. What ended

    def _collect_results(self, time: float) -> None:
        for tile, load in list(self._loading_generators.items()):
            if not load.done():
                continue
            del self._loading_generators[tile]
            try:
                worker, size = load.result()
            except GsgenError as error:
                self._record_tile_failure(tile, error, time)
                continue
            self.bytes += size
            self._retry_at.pop(tile, None)
            self._open_generators[tile] = _Generator(worker=worker, last_drawn=time)
            self._events.opened.append(tile)
        for tile, entry in list(self._open_generators.items()):
            if entry.pending is None or not entry.pending.done():
                continue
            run, entry.pending = entry.pending, None
            try:
                self._upload_delta(tile, entry, run.result())
            except GsgenError as error:
                self._record_tile_failure(tile, error, time)

    def _upload_delta(self, tile: int, entry: _Generator, delta: FrameDelta) -> None:
        """Convert the changed outputs of an ONNX generator's run to rows of the splat pool."""
        entry.rows = entry.rows if delta.rows is None else delta.rows
        entry.appearance = entry.appearance if delta.appearance is None else delta.appearance
        entry.drawn_inputs = entry.started_inputs
        self.runs += 1
        self._events.ran.append((tile, delta.count))
        is_unchanged = delta.rows is None and delta.appearance is None
        if is_unchanged and entry.result is not None and len(entry.result.rows) == delta.count:
            return
        assert entry.rows is not None
        assert entry.appearance is not None
        neural, tree = self._neural_tiles_by_index[tile], self._tree
        if delta.count > neural.splats_max:
            raise TilesetInvalid(
                f"a run of the generator gives {delta.count:,} Gaussians",
                expected=f"{neural.splats_max:,} or fewer, as declared",
                fault=Fault.NEURAL,
            )
        appearance = entry.worker.manifest.outputs.appearance
        assert appearance is not None  # the worker requires it
        entry.result = tile_rows(
            tile,
            entry.rows[: delta.count],
            entry.appearance[: delta.count],
            space=appearance.space,
            transform=tree.tiles[tile].transform,
            box=tree.box(tile),
            sh_degree=self._sh_degree,
        )

    def _record_tile_failure(self, tile: int, error: GsgenError, time: float) -> None:
        """Draw a tile's stored splats if its ONNX generator has failed, and report the reason."""
        self._release_generator(tile)
        is_transient = isinstance(error, StoreUnavailable | HostProcessFailed)
        self._retry_at[tile] = time + RETRY_AFTER if is_transient else np.inf
        message = str(error).replace("\n", " ")
        uri = self._neural_tiles_by_index[tile].uri
        message = message if uri in message else f"{uri}: {message}"
        line = f"{self._tree.tiles[tile].location}: {message}"
        self._events.failed.append((tile, line))
        self._report(f"{line}; the tile's splats are drawn")

    def _release_generator(self, tile: int) -> None:
        entry = self._open_generators.pop(tile, None)
        if entry is not None:
            entry.worker.interrupt()
            self._loader.submit(entry.worker.close)  # waits for the end of its run
            self._events.closed.append(tile)

    # ---- 2. and 3. Which generators are open

    def _largest_in_view(self, camera: Camera, tiles: Sequence[int], time: float) -> list[int]:
        """Return the tiles in view whose ONNX generators are to be open: the largest ones."""
        centers, axes = self._tree.center, self._tree.half_axes
        size = {
            tile: float(
                np.linalg.norm(axes[tile])
                / max(float(np.linalg.norm(centers[tile] - camera.eye)), 1e-9)
            )
            for tile in tiles
            if self._retry_at.get(tile, -np.inf) <= time
        }
        return sorted(size, key=lambda tile: (-size[tile], tile))[: self._options.neural_sessions]

    def _close_unused_generators(self, tiles: Sequence[int], time: float) -> None:
        """Close the longest unused ONNX generators to make room for those that this frame needs."""
        for tile in tiles:
            if tile in self._open_generators:
                self._open_generators[tile].last_drawn = time
        excess_generator_count = sum(
            tile not in self._open_generators and tile not in self._loading_generators
            for tile in tiles
        )
        excess_generator_count -= (
            self._options.neural_sessions
            - len(self._open_generators)
            - len(self._loading_generators)
        )
        unused_tiles = sorted(
            (tile for tile in self._open_generators if tile not in tiles),
            key=lambda tile: (self._open_generators[tile].last_drawn, tile),
        )
        for tile in unused_tiles[: max(excess_generator_count, 0)]:
            self._release_generator(tile)

    def _load_generators(self, tiles: Sequence[int]) -> None:
        """Begin to open the ONNX generator of the largest tile whose model is not open."""
        for tile in tiles:
            has_room = len(self._open_generators) < self._options.neural_sessions
            if tile not in self._open_generators and not self._loading_generators and has_room:
                self._loading_generators[tile] = self._loader.submit(self._opener.open, tile)

    # ---- 4. Runs

    def _inputs(self, tile: int, camera: Camera, values: Mapping[str, object]) -> _RunInputs:
        """Return the inputs that a tile's ONNX generator gets in this frame."""
        sees_camera = bool(set(self._neural_tiles_by_index[tile].inputs) & set(CAMERA_ROLES))
        view = (camera.view.tobytes(), camera.intrinsics) if sees_camera else None
        return _RunInputs(view, self._time(tile, values))

    def _time(self, tile: int, values: Mapping[str, object]) -> float | None:
        """Return the time to feed to a tile's ONNX generator; None if it has no time input."""
        span = self._neural_tiles_by_index[tile].time_range
        if span is None:
            return None
        value = float(np.asarray(values.get("time", span[0])).reshape(-1)[0])
        return min(max(value, span[0]), span[1])

    def _run_generators(
        self, inputs: Mapping[int, _RunInputs], camera: Camera, time: float
    ) -> None:
        """Begin runs of ONNX generators whose inputs changed, up to the limit per second."""
        rate = self._options.runs_per_second
        if np.isfinite(rate):
            self._run_tokens += rate * (time - self._token_time)
            self._run_tokens = min(self._run_tokens, float(max(self._options.neural_sessions, 1)))
        else:
            self._run_tokens = np.inf
        self._token_time = time
        ready = [
            tile
            for tile, run in inputs.items()
            if (entry := self._open_generators.get(tile))
            and entry.pending is None
            and entry.drawn_inputs != run
        ]
        for tile in sorted(ready, key=lambda tile: (self._open_generators[tile].last_run, tile)):
            if self._run_tokens < 1:
                break
            self._run_tokens -= 1
            entry, run = self._open_generators[tile], inputs[tile]
            entry.started_inputs, entry.last_run = run, time
            entry.pending = entry.worker.start(
                local_camera(camera, self._tree.tiles[tile].transform),
                {} if run.time is None else {"time": run.time},
            )

    # ---- 5. Uploads

    def _expected_content(self, tile: int) -> TileArrival:
        """Return the Gaussians that a tile should show: ONNX generator output, or stored splats."""
        entry = self._open_generators.get(tile)
        return self._contents[tile] if entry is None or entry.result is None else entry.result

    def _updates(self, uploaded: int) -> list[TileArrival]:
        """Return Gaussians of tiles to write to the splat pool, within the upload budget."""
        updates: list[TileArrival] = []
        for tile in sorted(self._pool_contents):
            # An upload that began ends first: else a tile that changes every frame never changes.
            rows, first_row = self._uploads.get(tile, (self._expected_content(tile), 0))
            if self._pool_contents[tile] is rows:
                continue
            remaining_bytes, part = self._options.upload_budget - uploaded, rows
            if self._is_streamed_in_parts(tile):
                part = rows.next_part(remaining_bytes, self._options.slot_rows, first_row=first_row)
            if uploaded and part.upload_bytes > remaining_bytes:
                continue
            updates.append(part)
            uploaded += part.upload_bytes
            if part.is_last:
                self._pool_contents[tile] = rows
                self._uploads.pop(tile, None)
            else:
                self._uploads[tile] = rows, part.end_row
        return updates

    def _is_streamed_in_parts(self, tile: int) -> bool:
        """Return whether a tile's slots have room for new Gaussians besides those drawn now."""
        content, reserved_count = self._contents[tile], self.reserved_rows(tile)
        is_doubled = reserved_count > self._neural_tiles_by_index[tile].splats_max
        return is_doubled and 2 * len(content.rows) <= reserved_count

    def _is_run_up_to_date(self, tile: int, inputs: _RunInputs) -> bool:
        entry = self._open_generators.get(tile)
        is_current = entry is not None and entry.drawn_inputs == inputs
        return is_current and self._pool_contents[tile] is self._expected_content(tile)
