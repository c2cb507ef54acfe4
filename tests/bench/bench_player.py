"""What Python adds to a frame: encoding and submitting, by how many models are drawn together.

CPU milliseconds of one thread, the least of many frames; a frame is small, so that the device has
nothing to do. Ratios are to submitting a command buffer that does nothing but copy the image.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.moving import drifting_model
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Residency
from gsgen.runtime.media.pictures import save_picture
from gsgen.runtime.playback.player import FrameRequest, GeneratorPlayer, Player
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.generator_worker import _OutputBuffer
from gsgen.runtime.sources.source import GeneratorSource
from gsgen.sdk.binding import FrameSession
from support.measures import print_figure

FRAMES = 200
GOALS = {1: 1.0, 32: 2.0}  # milliseconds
NOTHING_BEHIND = np.zeros(3)


def min_seconds(action: Callable[[], object], after: Callable[[], object]) -> float:
    """Return the least CPU milliseconds of this thread for an action, over many frames."""
    durations = []
    for _ in range(FRAMES):
        start_time = time.thread_time()
        action()
        durations.append(time.thread_time() - start_time)
        after()
    return 1000 * min(durations)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


def models(count: int) -> Scene:
    """Models of a hundred Gaussians with harmonics, each in a place of its own."""
    rng = np.random.default_rng(0)
    sets = []
    for number in range(count):
        rows = np.zeros((100, 10), np.float32)
        rows[:, :3], rows[:, 3], rows[:, [4, 7, 9]] = rng.normal(size=(100, 3)), 0.5, 1e-3
        transform = np.eye(4)
        transform[:3, 3] = 0.1 * number, 0, 0
        color = rng.normal(size=(100, 48)).astype(np.float32)
        sets.append(SplatSet(SplatData(rows, color, "sh"), transform))
    return Scene(sets)


@pytest.mark.parametrize("count", [1, 8, 32, 128])
def bench_encoding(renderer: Renderer, count: int) -> None:
    scene = models(count)
    camera = Camera.look_at((0, -1, -6), (0, 0, 0), width=64, height=48)
    renderer.render(scene, camera)
    placed = renderer.placed(scene)
    plan = renderer.plan(placed, camera, frozenset(["color"]))

    def frame(only: tuple[str, ...] | None = None) -> None:
        plan.submit(placed, camera, NOTHING_BEHIND, only=only)

    def nothing() -> None:
        encoder = renderer.device.raw.create_command_encoder(label="nothing")
        plan._readback.staging.encode(encoder)
        renderer.device.raw.queue.submit([encoder.finish()])

    whole, bare = min_seconds(frame, plan.collect), min_seconds(nothing, plan.collect)
    uniforms = min_seconds(lambda: frame(()), plan.collect) - bare
    steps = sum(map(len, plan.stages.values()))
    goal = f" (goal {GOALS[count]:g})" if count in GOALS else ""
    print_figure(
        f"{count:3} models, {steps} dispatches: {whole:.2f} ms{goal}, {whole / bare:.1f} times an"
    )
    print_figure(
        f"    empty one's {bare:.2f}; uniforms {uniforms:.2f}, dispatches {whole - uniforms - bare:.2f}"
    )
    placing_seconds = min_seconds(lambda: renderer.placed(scene), lambda: None)
    print_figure(f"    finding what changed {placing_seconds:.3f} ms")


def bench_what_stays(renderer: Renderer) -> None:
    """Noticing that a million Gaussians are as before, beside uploading them again."""
    rng = np.random.default_rng(0)
    result = [rng.normal(size=(1_000_000, width)).astype(np.float32) for width in (10, 48)]
    retained = [_OutputBuffer() for _ in result]
    data = SplatData(*result, "sh")
    residency = Residency(renderer.device)
    residency.pages(data)

    def cpu(action: Callable[[], object]) -> float:
        durations = []
        for _ in range(5):
            start_time = time.process_time()
            action()
            durations.append(time.process_time() - start_time)
        return 1000 * min(durations)

    def compare() -> None:
        for entry, array in zip(retained, result, strict=True):
            entry.take(array, len(array))

    def copy() -> None:
        for entry, array in zip(retained, result, strict=True):
            array[0] += 1
            entry.take(array, len(array))

    def upload() -> None:
        data.update(*result)
        residency.pages(data)

    compare()
    same, changed, uploaded = cpu(compare), cpu(copy), cpu(upload)
    print_figure(f"1 M Gaussians, degree 3: uploading takes {uploaded:.0f} CPU-ms; ")
    print_figure(
        f"noticing that nothing changed {same / uploaded:.2f} of that, copying {changed / uploaded:.2f}"
    )


def joined(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return spans of time with those that overlap joined to one."""
    whole: list[tuple[float, float]] = []
    for start_time, end in sorted(spans):
        if whole and start_time <= whole[-1][1]:
            whole[-1] = whole[-1][0], max(end, whole[-1][1])
        else:
            whole.append((start_time, end))
    return whole


def bench_overlap(renderer: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """How much of inference passes while a frame is drawn; both take turns without overlap."""
    drifting_model(200_000, degree=1).write(tmp_path / "many.onnx")
    camera = Camera.orbit((0, 0, 0), 4, width=320, height=180)
    times = np.linspace(0, 1, 12).tolist()
    spans: dict[str, list[tuple[float, float]]] = {
        name: [] for name in ("run", "render", "submit", "collect")
    }
    for name in spans:
        owner = FrameSession if name == "run" else Renderer

        def watched(
            *args: object,
            original: object = getattr(owner, name),
            name: str = name,
            **kwargs: object,
        ) -> object:
            start_time = time.perf_counter()
            result = original(*args, **kwargs)
            spans[name].append((start_time, time.perf_counter()))
            return result

        monkeypatch.setattr(owner, name, watched)

    def shared(play: Callable[[GeneratorPlayer], object]) -> float:
        with GeneratorPlayer(tmp_path / "many.onnx", provider="cpu", renderer=renderer) as player:
            player.render(camera, time=0.5)
            for span in spans.values():
                span.clear()
            play(player)
        in_flight = [
            (begin, end)
            for (begin, _), (_, end) in zip(spans["submit"], spans["collect"], strict=True)
        ]
        both = sum(
            max(0.0, min(a[1], b[1]) - max(a[0], b[0]))
            for a in spans["run"]
            for b in joined(spans["render"] + in_flight)
        )
        return both / sum(end - start_time for start_time, end in spans["run"])

    played = shared(lambda player: list(player.play(camera, times=times)))
    alone = shared(lambda player: [player.render(camera, time=time) for time in times])
    print_figure(
        f"200,000 moving Gaussians: {100 * played:.0f} % of inference passes while a frame is drawn or read, "
    )
    print_figure(f"{100 * alone:.0f} % where frames are rendered one by one")


@pytest.mark.parametrize("pixel_operations", ["frames alone", "with PNG files of them"])
def bench_frames_in_flight(renderer: Renderer, tmp_path: Path, pixel_operations: str) -> None:
    """What a film takes with two frames in flight, beside one that waits for each frame.

    Half of the frames are played in each way, in turns. Where the driver is software, drawing,
    inference and the host share the same cores, so that there is little to gain.
    """
    drifting_model(100_000, degree=1).write(tmp_path / "many.onnx")
    camera = Camera.orbit((0, 0, 0), 4, width=640, height=360)
    moments = np.linspace(0, 1, 8)
    durations: dict[int, list[float]] = {1: [], 2: []}
    waited: dict[int, list[float]] = {1: [], 2: []}
    source = GeneratorSource(tmp_path / "many.onnx")
    players = {
        count: Player([source], renderer=renderer, frames_in_flight=count) for count in durations
    }
    for turn in range(6):
        for count, player in players.items():
            requests = [FrameRequest(camera, ({"time": moment},)) for moment in moments]
            start_time = time.perf_counter()
            for number, frame in enumerate(player.play(requests)):
                if pixel_operations != "frames alone":
                    save_picture(tmp_path / f"{number}.png", frame.srgb8)
            if turn:  # the first one compiles
                durations[count].append(time.perf_counter() - start_time)
                waited[count].append(player.statistics.waited)
    source.close()
    ratio = np.median(np.divide(durations[2], durations[1]))
    first, two = (1000 * np.median(waited[count]) / len(moments) for count in (1, 2))
    print_figure(
        f"100,000 moving Gaussians, {pixel_operations}: with two frames in flight {ratio:.2f} of the time"
    )
    print_figure(
        f"    of waiting for each; the host waits {two:.1f} ms a frame instead of {first:.1f}"
    )
