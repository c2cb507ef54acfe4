"""What Python adds to a frame: encoding and submitting, by how many models are drawn together.

CPU milliseconds of one thread, the least of many frames; a frame is small, so that the device has
nothing to do. Ratios are to submitting a command buffer that does nothing but copy the image.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.moving import drifting
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Residency
from gsgen.runtime.playback.player import GeneratorPlayer
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.generator_worker import _OutputBuffer
from gsgen.sdk.binding import FrameSession
from support.measures import print_figure

FRAMES = 200
GOALS = {1: 1.0, 32: 2.0}  # milliseconds
NOTHING_BEHIND = np.zeros(3)


def least(action: Callable[[], object], after: Callable[[], object]) -> float:
    """Return the least CPU milliseconds of this thread for an action, over many frames."""
    taken = []
    for _ in range(FRAMES):
        began = time.thread_time()
        action()
        taken.append(time.thread_time() - began)
        after()
    return 1000 * min(taken)


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
        place = np.eye(4)
        place[:3, 3] = 0.1 * number, 0, 0
        color = rng.normal(size=(100, 48)).astype(np.float32)
        sets.append(SplatSet(SplatData(rows, color, "sh"), place))
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
        plan._staging.encode(encoder)
        renderer.device.raw.queue.submit([encoder.finish()])

    whole, bare = least(frame, plan.collect), least(nothing, plan.collect)
    uniforms = least(lambda: frame(()), plan.collect) - bare
    steps = sum(map(len, plan.stages.values()))
    goal = f" (goal {GOALS[count]:g})" if count in GOALS else ""
    print_figure(
        f"{count:3} models, {steps} dispatches: {whole:.2f} ms{goal}, {whole / bare:.1f} times an"
    )
    print_figure(
        f"    empty one's {bare:.2f}; uniforms {uniforms:.2f}, dispatches {whole - uniforms - bare:.2f}"
    )
    placing = least(lambda: renderer.placed(scene), lambda: None)
    print_figure(f"    finding what changed {placing:.3f} ms")


def bench_what_stays(renderer: Renderer) -> None:
    """Noticing that a million Gaussians are as before, beside uploading them again."""
    rng = np.random.default_rng(0)
    made = [rng.normal(size=(1_000_000, width)).astype(np.float32) for width in (10, 48)]
    kept = [_OutputBuffer() for _ in made]
    data = SplatData(*made, "sh")
    residency = Residency(renderer.device)
    residency.pages(data)

    def cpu(action: Callable[[], object]) -> float:
        taken = []
        for _ in range(5):
            began = time.process_time()
            action()
            taken.append(time.process_time() - began)
        return 1000 * min(taken)

    def compare() -> None:
        for one, array in zip(kept, made, strict=True):
            one.take(array, len(array))

    def copy() -> None:
        for one, array in zip(kept, made, strict=True):
            array[0] += 1
            one.take(array, len(array))

    def upload() -> None:
        data.update(*made)
        residency.pages(data)

    compare()
    same, changed, uploaded = cpu(compare), cpu(copy), cpu(upload)
    print_figure(f"1 M Gaussians, degree 3: uploading takes {uploaded:.0f} CPU-ms; ")
    print_figure(
        f"noticing that nothing changed {same / uploaded:.2f} of that, copying {changed / uploaded:.2f}"
    )


def bench_overlap(renderer: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """How much of inference passes while a frame is drawn; both take turns without overlap."""
    drifting(200_000, degree=1).write(tmp_path / "many.onnx")
    camera = Camera.orbit((0, 0, 0), 4, width=320, height=180)
    times = np.linspace(0, 1, 12).tolist()
    spans: dict[str, list[tuple[float, float]]] = {"run": [], "render": []}
    for owner in (FrameSession, Renderer):
        name = "run" if owner is FrameSession else "render"

        def watched(
            *args: object, plain: object = getattr(owner, name), name: str = name, **rest: object
        ) -> object:
            began = time.perf_counter()
            made = plain(*args, **rest)
            spans[name].append((began, time.perf_counter()))
            return made

        monkeypatch.setattr(owner, name, watched)

    def shared(play: Callable[[GeneratorPlayer], object]) -> float:
        with GeneratorPlayer(tmp_path / "many.onnx", provider="cpu", renderer=renderer) as player:
            player.render(camera, time=0.5)
            for one in spans.values():
                one.clear()
            play(player)
        both = sum(
            max(0.0, min(a[1], b[1]) - max(a[0], b[0]))
            for a in spans["run"]
            for b in spans["render"]
        )
        return both / sum(end - began for began, end in spans["run"])

    played = shared(lambda player: list(player.play(camera, times=times)))
    alone = shared(lambda player: [player.render(camera, time=at) for at in times])
    print_figure(
        f"200,000 moving Gaussians: {100 * played:.0f} % of inference passes while a frame is drawn, "
    )
    print_figure(f"{100 * alone:.0f} % where frames are rendered one by one")
