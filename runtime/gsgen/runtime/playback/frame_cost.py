"""What frames cost: time by stage, inference, and memory, measured on a film as it plays."""

__all__ = ["FrameCost", "Span", "measure"]

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from gsgen.runtime.gpu.gpu_timer import StageClock
from gsgen.runtime.kernels.raster.mesh_place import PlacedMesh
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.renderer.frame_plan import Placed, Plan
from gsgen.runtime.scene.camera import Camera

_UNMEASURED: Final = (
    2  # frames at the beginning: kernels are compiled, room is made for pairs
)
_STAGED: Final = 8  # frames whose stages are measured, at most
_NOTHING: Final = np.zeros(3)


@final
@dataclass(frozen=True, slots=True)
class Span:
    """Seconds that something took, over frames.

    Attributes:
        p50: The median.
        p95: Only one frame in twenty took longer.
    """

    p50: float
    p95: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> "Span":
        """Return the span of some measurements."""
        p50, p95 = np.percentile(seconds, [50, 95])
        return cls(float(p50), float(p95))


@final
@dataclass(frozen=True, slots=True)
class FrameCost:
    """What the frames of a film cost; counts are medians.

    Attributes:
        device: What drew.
        software: Whether that is a driver that runs on the CPU.
        size: Width and height, in pixels.
        frames: How many were measured.
        wall: From one frame to the next, as it plays.
        cpu: CPU seconds of the process for a frame, all threads together; on a software driver
            the device's work is in it.
        submit: CPU seconds of one thread to encode and submit a frame.
        inference: What computing a frame took, by generator; absent where nothing was computed.
        stages: Seconds of each stage of drawing.
        clock: What told them: the device's timestamps, or the CPU time that each stage adds to
            those before it.
        gaussians: Live ones.
        visible: Those that were drawn.
        pairs: Of a splat and a tile that it touches.
        rows_bytes: Of the Gaussians on the device: rows, harmonics, cells.
        plan_bytes: Of all else that is there for a frame.
        capacity: Gaussians that the device has room for.
    """

    device: str
    software: bool
    size: tuple[int, int]
    frames: int
    wall: Span
    cpu: Span
    submit: Span
    inference: Mapping[str, Span]
    stages: Mapping[str, float]
    clock: Literal["timestamps", "cpu"]
    gaussians: int
    visible: int
    pairs: int
    rows_bytes: int
    plan_bytes: int
    capacity: int


def measure(
    film: FrameSequence, watch: Callable[[str], None] = lambda _: None
) -> FrameCost:
    """Play a film without writing it, and say what its frames cost.

    Args:
        film: What is measured; some frames more are drawn before it.
        watch: Is told what is being done.
    """
    device, camera = film.player.renderer.device, film.shot(0).camera
    watch("warming up")
    for number in range(min(film.frames, _UNMEASURED)):
        film.draw(number)
    watch(f"drawing {film.frames} frames")
    played = _play(film)
    watch("measuring stages")
    with device.translate_errors():
        staged = _stage(film)
    return FrameCost(
        device=device.name,
        software=device.software,
        size=(camera.width, camera.height),
        frames=film.frames,
        wall=Span.of(played.wall),
        cpu=Span.of(played.cpu),
        submit=Span.of(staged.submit),
        inference={
            name: Span.of(seconds) for name, seconds in played.inference.items() if seconds
        },
        stages=staged.stages,
        clock=staged.clock,
        gaussians=int(np.median(played.gaussians)),
        visible=int(np.median(played.visible)),
        pairs=int(np.median(played.pairs)),
        rows_bytes=staged.rows_bytes,
        plan_bytes=staged.plan_bytes,
        capacity=len(film.player.scene),
    )


@dataclass(frozen=True, slots=True)
class _Played:
    """What was measured while frames were played."""

    wall: list[float]
    cpu: list[float]
    inference: dict[str, list[float]]
    gaussians: list[int]
    visible: list[int]
    pairs: list[int]


def _play(film: FrameSequence) -> _Played:
    played = _Played([], [], {source.name: [] for source in film.sources}, [], [], [])
    started, busy = time.perf_counter(), time.process_time()
    for frame in film.player.play(map(film.shot, range(film.frames))):
        now, used = time.perf_counter(), time.process_time()
        played.wall.append(now - started)
        played.cpu.append(used - busy)
        started, busy = now, used
        played.visible.append(frame.visible)
        played.pairs.append(frame.pairs)
        played.gaussians.append(sum(source.data.count for source in film.sources))
        for source in film.sources:
            if source.seconds:
                played.inference[source.name].append(source.seconds)
    return played


@dataclass(frozen=True, slots=True)
class _Staged:
    """What was measured stage by stage."""

    submit: list[float]
    stages: dict[str, float]
    clock: Literal["timestamps", "cpu"]
    rows_bytes: int
    plan_bytes: int


def _stage(film: FrameSequence) -> _Staged:
    """Draw some frames of the film stage by stage."""
    renderer = film.player.renderer
    clock = StageClock(renderer.device) if renderer.device.has_clock else None
    frame_numbers = np.unique(np.linspace(0, film.frames - 1, _STAGED).round().astype(int))
    submit: list[float] = []
    rows: list[dict[str, float]] = []
    clock_kind: Literal["timestamps", "cpu"] = "timestamps"
    _Part.of(film, film.frames - 1).submit(clock)  # the first timestamps take long
    for number in frame_numbers:
        film.draw(int(number))
        part = _Part.of(film, int(number))
        submit.append(part.submit(clock))
        ticks = clock.seconds() if clock is not None else {}
        if not any(ticks.values()):
            clock_kind, ticks = "cpu", part.added()
        rows.append(ticks)
    stages = {name: float(np.median([row[name] for row in rows])) for name in rows[0]}
    return _Staged(submit, stages, clock_kind, part.rows_bytes, part.plan_bytes)


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A frame that was drawn, and can be drawn again in parts."""

    plan: Plan
    placed: list[Placed]
    meshes: list[PlacedMesh]
    camera: Camera

    @classmethod
    def of(cls, film: FrameSequence, number: int) -> "_Part":
        renderer, camera = film.player.renderer, film.shot(number).camera
        scene = film.player.scene
        placed, meshes = renderer.placed(scene), renderer.placed_meshes(scene)
        plan = renderer.plan(placed, camera, frozenset({"color"}), meshes)
        return cls(plan, placed, meshes, camera)

    def submit(
        self, clock: StageClock | None = None, only: Sequence[str] | None = None
    ) -> float:
        """Draw; return the CPU seconds that this thread took until the device had everything."""
        started = time.thread_time()
        self.plan.submit(
            self.placed, self.camera, _NOTHING, meshes=self.meshes, only=only, clock=clock
        )
        seconds = time.thread_time() - started
        self.plan.collect()
        return seconds

    def added(self) -> dict[str, float]:
        """Return the CPU seconds that each stage adds to those before it, which it needs."""
        names = list(self.plan.stages)
        sums = []
        for length in range(len(names) + 1):
            started = time.process_time()
            self.submit(only=names[:length])
            sums.append(time.process_time() - started)
        return {
            name: max(b - a, 0.0) for name, a, b in zip(names, sums, sums[1:], strict=False)
        }

    @property
    def rows_bytes(self) -> int:
        """Bytes of what is there of the Gaussians; sets may share them."""
        buffers = [
            buffer
            for _, page in self.placed
            for buffer in (page.rows, page.appearance, page.cells)
            if buffer is not None
        ]
        return sum({id(buffer): buffer.size for buffer in buffers}.values())

    @property
    def plan_bytes(self) -> int:
        """Bytes of what is there for a frame."""
        return sum(buffer.size for buffer in self.plan.buffers.values())
