"""What a frame costs: CPU seconds on a software driver, stage by stage, beside the floor.

CPU seconds are those of the whole process, the driver's threads included, so that other load on
the machine counts less; the least of several frames is printed. The floor is what the least bytes
and operations of the same frame would take on the same cores, by rates measured in the same run.
"""

import time
from collections.abc import Callable

import numpy as np
import pytest

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import PAGE_ROWS
from gsgen.runtime.kernels.shared import counts as counting
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import run
from gsgen.runtime.kernels.shared.shader import TILE
from gsgen.runtime.kernels.sort.scan import Scan
from gsgen.runtime.kernels.sort.sort import Columns, RadixSort, sort_config_for
from gsgen.runtime.kernels.tiles.list_tiles import run_count
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.placed_pages import PlacedPage
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from references.sorting import sort_reference
from support.measures import print_figure
from support.rendering.room import room_parts

MILLION = 1_000_000
SIZES = {(1280, 720): 0.40, (640, 360): 0.30}  # CPU seconds to aim at
GOAL_BYTES = 48  # per Gaussian without harmonics
NOTHING_BEHIND = np.zeros(3)


def cpu(action: Callable[[], object], times: int = 5) -> float:
    """Return the least CPU seconds of several runs."""
    durations = []
    for _ in range(times):
        start_time = time.process_time()
        action()
        durations.append(time.process_time() - start_time)
    return min(durations)


def room(n: int = MILLION) -> SplatData:
    parts = room_parts(n)
    rows = np.zeros((n, 10), np.float32)
    rows[:, :3], rows[:, 3] = parts["center"], parts["opacity"]
    rows[:, 4:] = covariance_upper(parts["scale"], parts["turn"])
    return SplatData(rows, parts["color"], "sh")


@pytest.fixture(scope="module")
def device() -> Device:
    return Device.open()


@pytest.fixture(scope="module")
def renderer(device: Device) -> Renderer:
    return Renderer(device, rasteriser="tiles")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene([room()])


def planned(renderer: Renderer, scene: Scene, camera: Camera) -> tuple[Plan, list[PlacedPage], int]:
    """Draw once, so that there is room for all pairs; return the plan, its pages, the pairs."""
    pairs = renderer.render(scene, camera).pairs
    placed = renderer.placed(scene)
    return renderer.plan(placed, camera, frozenset(["color"])), placed, pairs


def minimum_bytes(
    gaussians: int, visible: int, pairs: int, pixels: int, row: int, harmonics: int
) -> dict[str, float]:
    """Return the least bytes of each stage, as the renderer is built."""
    tiles = pixels // TILE**2
    counters = tiles * run_count(tiles)
    return {
        "project": gaussians * (row + 12) + visible * (harmonics + 3 * 16),
        "sort": gaussians * 4 * 2 + visible * (8 + 3 * (4 + 8 + 8) + 4),
        "bin": visible * (4 + 4 + 4) + counters * 4 * 4,
        "group": visible * (4 + 4) + pairs * 4 + counters * 4 * 2,
        "blend": pairs * (4 + 48) + pixels * 16,
    }


def copy_rate() -> float:
    """Return bytes read and written in a second of one core, by copying 256 MB."""
    source, target = np.ones(1 << 25), np.empty(1 << 25)
    return 2 * source.nbytes / cpu(lambda: np.copyto(target, source))


def flops() -> float:
    """Return float32 operations in a second of one core, by NumPy on numbers in its cache."""
    numbers, times = np.ones(4096, np.float32), 2000

    def multiply() -> None:
        for _ in range(times):
            np.multiply(numbers, numbers, out=numbers)

    return numbers.size * times / cpu(multiply)


@pytest.mark.parametrize("compact", [False, True], ids=["exact", "compact"])
@pytest.mark.parametrize("size", SIZES)
def bench_a_million(device: Device, scene: Scene, size: tuple[int, int], compact: bool) -> None:
    renderer = Renderer(device, rasteriser="tiles", compact=compact)
    camera = Camera.look_at((-2.5, -0.5, -3), (1, 0.3, 1), width=size[0], height=size[1])
    plan, placed, pairs = planned(renderer, scene, camera)

    def frame(*stages: str) -> None:
        plan.submit(placed, camera, NOTHING_BEHIND, only=stages or None)
        plan.collect()

    frame()
    counts = renderer.device.read(plan.buffers["counts"], np.uint32, 4)
    visible = int(counts[Counts.VISIBLE])
    kind = "float16" if compact else "float32"
    print_figure(
        f"1 M Gaussians, degree 3 in {kind}, {size[0]}×{size[1]}, {renderer.device.name}: "
    )
    print_figure(f"{visible:,} visible, {pairs:,} pairs")
    rate = copy_rate()
    unchanged_bytes = (32, 96) if compact else (40, 192)  # bytes of a row, and of its harmonics
    min_costs = minimum_bytes(MILLION, visible, pairs, size[0] * size[1], *unchanged_bytes)
    idle_seconds = cpu(lambda: frame("none"))  # uniforms, clearing, and copying the image back
    names = list(plan.stages)
    # What a stage adds to those before it: each needs what they made.
    sums = [idle_seconds, *(cpu(lambda n=n: frame(*names[: n + 1])) for n in range(len(names)))]
    for number, name in enumerate(names):
        bytes_ = min_costs[name]
        print_figure(
            f"{name:8} {sums[number + 1] - sums[number]:.3f} CPU-s; "
            f"{bytes_ / 1e6:5.0f} MB, at one core's copying rate {bytes_ / rate:.3f} s"
        )
    pixel_operations = (
        14 * pairs * TILE**2
    )  # of a tile's pixels with a splat, each takes about 14 operations
    print_figure(
        f"blend at most {pixel_operations / 1e9:.1f} G operations, one core's rate {pixel_operations / flops():.3f} s"
    )
    print_figure(f"uniforms and reading back {idle_seconds:.3f} CPU-s")
    print_figure(f"frame {sums[-1]:.3f} CPU-s (goal {SIZES[size]})")
    start_time = time.perf_counter()
    frame()
    print_figure(f"frame {time.perf_counter() - start_time:.3f} s of wall clock")


@pytest.mark.parametrize("size", SIZES)
def bench_what_changes(
    device: Device, scene: Scene, monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]
) -> None:
    """Frames of new values, in memory that is mapped and arranged, and by copies in own order."""
    camera = Camera.look_at((-2.5, -0.5, -3), (1, 0.3, 1), width=size[0], height=size[1])
    print_figure(f"1 M Gaussians, degree 3 in float32, {size[0]}×{size[1]}: ")
    drawn = []
    for maps in dict.fromkeys((False, device.maps_buffers)):
        monkeypatch.setattr(device, "maps_buffers", maps)
        renderer = Renderer(device, rasteriser="tiles")
        rows, appearance = scene.sets[0].data.rows, scene.sets[0].data.appearance
        data = SplatData(rows, appearance, "sh")

        def frame(
            *values: np.ndarray | None,
            renderer: Renderer = renderer,
            data: SplatData = data,
            camera: Camera = camera,
        ) -> np.ndarray:
            data.update(*values)
            return renderer.render(Scene([data]), camera).rgba

        frame(rows)
        drawn.append(frame(rows))
        print_figure("mapped: " if maps else "copied: ")
        for name, values in (
            ("rows", (rows, None)),
            ("harmonics", (None, appearance)),
            ("both", (rows, appearance)),
            ("nothing", ()),
        ):
            print_figure(f"  {name:9} new {cpu(lambda v=values: frame(*v)):.3f} CPU-s")
    assert all(np.array_equal(entry, drawn[0]) for entry in drawn)


@pytest.mark.parametrize("size", SIZES)
def bench_quads(device: Device, scene: Scene, size: tuple[int, int]) -> None:
    """The hardware's rasteriser beside the tiles; a software driver has none."""
    camera = Camera.look_at((-2.5, -0.5, -3), (1, 0.3, 1), width=size[0], height=size[1])
    durations = {}
    for rasteriser in ("tiles", "quads"):
        own_renderer = Renderer(device, rasteriser=rasteriser)
        own_renderer.render(scene, camera)
        durations[rasteriser] = cpu(
            lambda own_renderer=own_renderer: own_renderer.render(scene, camera), 3
        )
    print_figure(f"{size[0]}×{size[1]}, frame by tiles {durations['tiles']:.3f} CPU-s, ")
    print_figure(f"by quads {durations['quads']:.3f}")


def bench_panorama(device: Device, scene: Scene) -> None:
    """All around, beside a picture of as many pixels that sees a part of it."""
    eye, toward = (-0.5, -0.3, -0.4), (1.0, 0.1, 0.4)
    forward_camera = Camera.look_at(eye, np.add(eye, toward).tolist(), width=1024, height=512)
    around = Camera.panorama(eye, toward, width=1024)
    for name, camera in (("pinhole", forward_camera), ("panorama", around)):
        own_renderer = Renderer(device, rasteriser="tiles")
        plan, placed, pairs = planned(own_renderer, scene, camera)

        def frame(
            *stages: str,
            plan: Plan = plan,
            placed: list[PlacedPage] = placed,
            camera: Camera = camera,
        ) -> None:
            plan.submit(placed, camera, NOTHING_BEHIND, only=stages or None)
            plan.collect()

        frame()
        visible = int(device.read(plan.buffers["counts"], np.uint32, 4)[Counts.VISIBLE])
        idle_seconds, projected, total_seconds = (
            cpu(lambda: frame("none")),
            cpu(lambda: frame("project")),
            cpu(frame),
        )
        print_figure(f"{name:8} 1024×512: {visible:,} visible, {pairs:,} pairs, ")
        print_figure(f"  project {projected - idle_seconds:.3f} CPU-s, frame {total_seconds:.3f}")


def bench_encoding(renderer: Renderer) -> None:
    small = Scene([room(1000)])
    camera = Camera.look_at((-2.5, -0.5, -3), (1, 0.3, 1), width=64, height=48)
    plan, placed, _ = planned(renderer, small, camera)

    def encode() -> None:
        for _ in range(20):
            plan.submit(placed, camera, NOTHING_BEHIND, only=())
        plan.collect()

    def both() -> None:
        for _ in range(20):
            start_time.append(time.thread_time())
            plan.submit(placed, camera, NOTHING_BEHIND)
            durations.append(time.thread_time() - start_time[-1])
            plan.collect()

    start_time: list[float] = []
    durations: list[float] = []
    encode()
    both()
    steps = sum(map(len, plan.stages.values()))
    print_figure(
        f"encode and submit {steps} dispatches: {1000 * min(durations):.2f} ms of one thread"
    )


def bench_memory(device: Device, scene: Scene) -> None:
    """Bytes per Gaussian: what stays on the GPU, and what a frame takes beside it."""
    camera = Camera.look_at((-2.5, -0.5, -3), (1, 0.3, 1), width=640, height=360)
    data = scene.sets[0].data
    for compact in (False, True):
        renderer = Renderer(device, rasteriser="tiles", compact=compact)
        unchanged_sizes = []
        for degree in (0, 1, 2, 3):
            reduced_data = SplatData(data.rows, data.appearance[:, : 3 * (degree + 1) ** 2], "sh")
            pages = [page for _, page in renderer.placed(Scene([reduced_data]))]
            unchanged_sizes.append(sum(page.rows.size + page.appearance.size for page in pages))
        print_figure("compact: " if compact else "exact: ")
        print_figure(
            "  ".join(f"degree {d} {size / MILLION:.0f}" for d, size in enumerate(unchanged_sizes))
        )
        print_figure(
            f"bytes stay per Gaussian (goal {GOAL_BYTES} at degree 0, and what is above it)"
        )
    plan, _, pairs = planned(renderer, scene, camera)
    of_gaussians = ("keys of G", "values of G", "lows", "shapes", "weights", "colors")
    of_gaussians += ("origins",)
    splats = sum(
        buffer.size for name, buffer in plan.buffers.items() if name.startswith(of_gaussians)
    )
    remaining = sum(buffer.size for buffer in plan.buffers.values()) - splats
    print_figure(f"the plan of a frame takes {splats / MILLION:.0f} bytes per Gaussian, and ")
    print_figure(f"{remaining / 1e6:.0f} MB for {pairs / MILLION:.1f} million pairs and the image")
    print_figure(f"largest binding: {max(b.size for b in plan.buffers.values()) / 2**20:.0f} MiB, ")
    print_figure(f"a page of {PAGE_ROWS:,} rows {PAGE_ROWS * 192 / 2**20:.0f} MiB")


def bench_sorting_four_million(renderer: Renderer) -> None:
    """The long test of the sort: compared with NumPy, too."""
    device: Device = renderer.device
    n, cut = 4 * MILLION, sort_config_for(device)
    keys = np.random.default_rng(0).uniform(0.01, 100, n).astype(np.float32).view(np.uint32)
    sort = RadixSort(device, cut, Scan(device, cut.block, 64, 256))
    counts = device.storage("counts", counting.COUNTERS_BYTES, extra_usage="INDIRECT")
    columns = [
        Columns(device.storage("keys", 4 * n), device.storage("values", 4 * n)) for _ in range(2)
    ]
    steps, result_index = sort.steps(
        counts,
        sort.histograms(n, 32),
        columns,
        bits=32,
        source=Counts.VISIBLE,
        groups=Counts.SORT_VISIBLE_GROUPS,
        compact_counter=n,
    )
    device.write(counts, counting.initial(n, 0))

    def once() -> None:
        device.write(columns[0].keys, keys)
        encoder = device.raw.create_command_encoder()
        run(encoder, steps, "sort")
        device.raw.queue.submit([encoder.finish()])
        device.read(counts, np.uint32, 1)

    seconds = cpu(once, 3)
    expected = sort_reference(keys, 32)
    np.testing.assert_array_equal(device.read(columns[result_index].values, np.uint32, n), expected)
    numpys = cpu(lambda: np.argsort(keys, kind="stable"), 2)
    print_figure(f"sort of 4 M keys: {seconds:.3f} CPU-s, numpy's stable argsort {numpys:.3f}")


def bench_two_hundred_still_frames(renderer: Renderer, scene: Scene) -> None:
    """Memory stays where it is from frame to frame."""
    import resource

    camera = Camera.look_at((-2.5, -0.5, -3), (1, 0.3, 1), width=160, height=90)
    small = Scene([SplatSet(room(10_000))])
    renderer.render(small, camera)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(200):
        renderer.render(small, camera)
    memory_growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    print_figure(f"200 frames: peak memory grew by {memory_growth / 1024:.1f} MiB")
    assert memory_growth < 20 * 1024
