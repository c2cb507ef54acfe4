"""Measures the time of each stage and model, and the memory, of the frames of a playback."""

__all__ = ["FrameCost", "Span", "measure"]

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, final

import numpy as np

from gsgen.runtime.errors import CapacityExceeded
from gsgen.runtime.gpu.gpu_timer import StageClock
from gsgen.runtime.kernels.raster.mesh_place import PlacedMesh
from gsgen.runtime.playback.frame_sequence import FrameSequence
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.placed_pages import PlacedPage
from gsgen.runtime.scene.camera import Camera

_WARM_UP_FRAMES: Final = 2  # these compile kernels and grow the buffer of pairs
_MAX_MEASURED_FRAMES: Final = 8  # most frames whose stages are measured
_BLACK_RGB: Final = np.zeros(3)


@final
@dataclass(frozen=True, slots=True)
class Span:
    """The median and the 95th percentile of a duration over several frames, in seconds."""

    p50: float
    p95: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> "Span":
        """Return the median and the 95th percentile of measured seconds."""
        p50, p95 = np.percentile(seconds, [50, 95])
        return cls(float(p50), float(p95))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FrameCost:
    """Time and memory of drawing the frames of a sequence; counts are medians over frames.

    Attributes:
        device: Name of the graphics device.
        software: Whether the device's driver runs on the CPU.
        size: Width and height, in pixels.
        frames: Number of measured frames.
        wall: Seconds from one frame to the next.
        cpu: CPU seconds per frame, all threads together; on a software driver they include the
            device's work.
        submit: CPU seconds of one thread to encode and submit a frame.
        inference: Seconds to compute a frame, by generator; absent where none was computed.
        stages: Seconds of each stage of drawing.
        clock: Clock of ``stages``: the device's timestamps, or the CPU time that each stage adds
            to those before it.
        gaussians: Number of live Gaussians.
        visible: Number of drawn Gaussians.
        pairs: Number of pairs of a splat and a tile that it touches.
        rows_bytes: Bytes of the Gaussians on the device: rows, harmonics, cells.
        plan_bytes: Bytes of all other buffers of a frame.
        capacity: Gaussians that the device has room for.
        frames_in_flight: Most frames that were submitted, and not read yet, at the same time.
        waited: Seconds per frame, on average, that the host stood still while it submitted and
            read frames.
        growths: How often buffers were enlarged after the first frames.
        redrawn: Number of frames that were drawn again because their buffers were too small.
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
    frames_in_flight: int
    waited: float
    growths: int
    redrawn: int


def measure(sequence: FrameSequence, on_step: Callable[[str], None] = lambda _: None) -> FrameCost:
    """Play a frame sequence without writing files, and return the time and memory of its frames.

    A few frames are drawn twice to warm up; ``on_step`` is called with the name of each step.
    """
    device, camera = sequence.player.renderer.device, sequence.frame_request(0).camera
    on_step("warming up")
    for number in range(min(sequence.frames, _WARM_UP_FRAMES)):
        sequence.draw(number)
    on_step(f"drawing {sequence.frames} frames")
    playback_cost, statistics = _play_frames(sequence), sequence.player.statistics
    on_step("measuring stages")
    with device.translate_errors():
        staged_cost = _measure_stages(sequence)
    return FrameCost(
        device=device.name,
        software=device.software,
        size=(camera.width, camera.height),
        frames=sequence.frames,
        wall=Span.of(playback_cost.wall),
        cpu=Span.of(playback_cost.cpu),
        submit=Span.of(staged_cost.submit),
        inference={
            name: Span.of(seconds) for name, seconds in playback_cost.inference.items() if seconds
        },
        stages=staged_cost.stages,
        clock=staged_cost.clock,
        gaussians=int(np.median(playback_cost.gaussians)),
        visible=int(np.median(playback_cost.visible)),
        pairs=int(np.median(playback_cost.pairs)),
        rows_bytes=staged_cost.rows_bytes,
        plan_bytes=staged_cost.plan_bytes,
        capacity=len(sequence.player.scene),
        frames_in_flight=statistics.in_flight,
        waited=statistics.waited / max(1, statistics.frames),
        growths=statistics.growths,
        redrawn=statistics.redrawn,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _PlaybackCost:
    """Times and counts of each frame of a played sequence: inference, drawing, Gaussians."""

    inference: dict[str, list[float]]
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    gaussians: list[int] = field(default_factory=list)
    visible: list[int] = field(default_factory=list)
    pairs: list[int] = field(default_factory=list)


def _play_frames(sequence: FrameSequence) -> _PlaybackCost:
    playback_cost = _PlaybackCost(inference={source.name: [] for source in sequence.sources})
    started, cpu_start = time.perf_counter(), time.process_time()
    for frame in sequence.player.play(sequence.frame_requests()):
        now, used = time.perf_counter(), time.process_time()
        playback_cost.wall.append(now - started)
        playback_cost.cpu.append(used - cpu_start)
        started, cpu_start = now, used
        playback_cost.visible.append(frame.visible)
        playback_cost.pairs.append(frame.pairs)
        playback_cost.gaussians.append(sum(source.count for source in sequence.sources))
        for source in sequence.sources:
            if source.seconds:
                playback_cost.inference[source.name].append(source.seconds)
    return playback_cost


@dataclass(frozen=True, slots=True, kw_only=True)
class _StageCost:
    """The seconds of each drawing stage, and the bytes of the buffers, of a frame sequence."""

    submit: list[float]
    stages: dict[str, float]
    clock: Literal["timestamps", "cpu"]
    rows_bytes: int
    plan_bytes: int


def _measure_stages(sequence: FrameSequence) -> _StageCost:
    """Draw some frames of a sequence stage by stage, and measure them."""
    renderer = sequence.player.renderer
    clock = StageClock(renderer.device) if renderer.device.has_clock else None
    frame_numbers = np.unique(
        np.linspace(0, sequence.frames - 1, _MAX_MEASURED_FRAMES).round().astype(int)
    )
    submit: list[float] = []
    rows: list[dict[str, float]] = []
    clock_kind: Literal["timestamps", "cpu"] = "timestamps"
    _PlannedFrame.of(sequence, sequence.frames - 1).submit(clock)  # the first timestamps are slow
    for number in frame_numbers:
        sequence.draw(int(number))
        planned_frame = _PlannedFrame.of(sequence, int(number))
        submit.append(planned_frame.submit(clock))
        ticks = clock.seconds() if clock is not None else {}
        if not any(ticks.values()):
            clock_kind, ticks = "cpu", planned_frame.stage_seconds()
        rows.append(ticks)
    stages = {name: float(np.median([row[name] for row in rows])) for name in rows[0]}
    return _StageCost(
        submit=submit,
        stages=stages,
        clock=clock_kind,
        rows_bytes=planned_frame.rows_bytes,
        plan_bytes=planned_frame.plan_bytes,
    )


@final
@dataclass(frozen=True, slots=True, eq=False)
class _PlannedFrame:
    """The recorded GPU work of a frame, which can be drawn again up to any stage."""

    plan: Plan
    placed: list[PlacedPage]
    meshes: list[PlacedMesh]
    camera: Camera

    @classmethod
    def of(cls, sequence: FrameSequence, number: int) -> "_PlannedFrame":
        renderer, camera = sequence.player.renderer, sequence.frame_request(number).camera
        scene = sequence.player.scene
        placed, meshes = renderer.placed(scene), renderer.placed_meshes(scene)
        plan = renderer.plan(placed, camera, frozenset({"color"}), meshes)
        slabs = plan.weighted_slabs or plan.slabs
        if slabs is not None:
            raise CapacityExceeded(
                f"the scene has more than {slabs.capacity:,} splats, the most that "
                f"{renderer.device.name} draws at once; expected fewer to time each GPU stage",
                where="scene",
                hint="Measure fewer Gaussians; `gsgen convert --decimate 50%` halves a file.",
            )
        return cls(plan, placed, meshes, camera)

    def submit(self, clock: StageClock | None = None, only: Sequence[str] | None = None) -> float:
        """Draw the frame; return this thread's CPU seconds until the GPU work was submitted."""
        started = time.thread_time()
        self.plan.submit(
            self.placed, self.camera, _BLACK_RGB, meshes=self.meshes, only=only, clock=clock
        )
        seconds = time.thread_time() - started
        self.plan.collect()
        return seconds

    def stage_seconds(self) -> dict[str, float]:
        """Return the CPU seconds that each stage of a frame adds to the previous stages."""
        names = list(self.plan.stages)
        sums = []
        for length in range(len(names) + 1):
            started = time.process_time()
            self.submit(only=names[:length])
            sums.append(time.process_time() - started)
        return {name: max(b - a, 0.0) for name, a, b in zip(names, sums, sums[1:], strict=False)}

    @property
    def rows_bytes(self) -> int:
        """Size in bytes of the GPU buffers of Gaussians; shared buffers count once."""
        buffers = [
            buffer
            for _, page in self.placed
            for buffer in (page.rows, page.appearance, page.cells)
            if buffer is not None
        ]
        return sum({id(buffer): buffer.size for buffer in buffers}.values())

    @property
    def plan_bytes(self) -> int:
        """Size in bytes of the GPU buffers that the recorded GPU work of a frame owns."""
        return sum(buffer.size for buffer in self.plan.buffers.values())
