"""What a large frame costs on this machine's graphics device, and how exact it is; unattended.

    python tests/bench/gpu.py [--gaussians 6060000] [--size 1920x1080] [--degree 3] [--frames 30]

For a GPU that a checkout is carried to: nothing has to be installed but wheels of numpy, jaxtyping
(with wadler-lindig), wgpu (with cffi and pycparser) and pillow, and the system's Vulkan loader
(libvulkan1) with the GPU's driver. The script finds the packages of its own checkout itself, so it
runs from anywhere. On a software driver try it small: ``--gaussians 20000 --size 320x180``.

It makes a deterministic crowd of Gaussians of which three quarters are in the image, and writes

- ``gpu.json``: for tiles and quads, exact and compact rows, the milliseconds of each stage by the
  device's timestamps, and of a whole frame by the wall, frame after frame without reading anything;
  the least milliseconds by bytes and by operations at the rates of a copy and of a loop of fused
  multiplications on the same device; the error of a crop of the image beside the float64 oracle;
  keys sorted in a second; what the rasteriser's probe measured and chose; which kernels the device
  gets; gsplat's CUDA rasteriser on the same scene, where it is installed with torch (that part was
  written by gsplat's documentation, and has never run); bytes, dispatches and reads of keys of a
  frame of 6.06 M, counted from its plan;
- ``gpu_MODE.png``: the pictures, and ``gpu_crop_oracle.png``: the crop by the oracle

into ``$OUT``, or ``out/gpu`` of the checkout. It exits 0 if everything was measured, and every part
that failed is named in ``gpu.json`` under "failed", with exit status 1.
"""

import argparse
import json
import os
import statistics
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / part) for part in ("contract", "runtime", "tests")]

import numpy as np  # noqa: E402

from gsgen.contract.spec.geometry import covariance_upper  # noqa: E402
from gsgen.runtime.gpu.device import Device  # noqa: E402
from gsgen.runtime.gpu.gpu_timer import StageClock  # noqa: E402
from gsgen.runtime.kernels.shared import counts as counting  # noqa: E402
from gsgen.runtime.kernels.shared.counts import Counts  # noqa: E402
from gsgen.runtime.kernels.shared.kernel import run  # noqa: E402
from gsgen.runtime.kernels.shared.shader import TILE  # noqa: E402
from gsgen.runtime.kernels.sort.scan import Scan  # noqa: E402
from gsgen.runtime.kernels.sort.sort import Columns, RadixSort, sort_config_for  # noqa: E402
from gsgen.runtime.oracle import render as oracle  # noqa: E402
from gsgen.runtime.renderer import rasteriser_choice  # noqa: E402
from gsgen.runtime.renderer.frame_plan import Plan  # noqa: E402
from gsgen.runtime.renderer.kernel_set import Kernels  # noqa: E402
from gsgen.runtime.renderer.placed_pages import PlacedPage  # noqa: E402
from gsgen.runtime.renderer.renderer import Renderer  # noqa: E402
from gsgen.runtime.scene.camera import Camera  # noqa: E402
from gsgen.runtime.scene.scene import Scene  # noqa: E402
from gsgen.runtime.scene.splat_data import SplatData  # noqa: E402
from references.sorting import sort_reference  # noqa: E402
from support.measures import print_line  # noqa: E402
from support.rendering import frame_traffic, splat_scenes  # noqa: E402
from support.rendering.gsplat_timing import gsplat_milliseconds  # noqa: E402

MODES: Final = {
    "tiles": {"rasteriser": "tiles"},
    "quads": {"rasteriser": "quads"},
    "tiles, compact": {"rasteriser": "tiles", "compact": True},
    "quads, compact": {"rasteriser": "quads", "compact": True},
}
IN_IMAGE: Final = 0.76  # of the Gaussians
WARM_UP_FRAMES: Final = (
    3  # frames: the second one arranges rows, the third has grown room for all pairs
)
FLOPS_OF_A_PIXEL: Final = 14  # that a splat is blended into
CROP: Final = (256, 144)
NOTHING: Final = np.zeros(3)
CHAINS: Final = 8
LEAST_KEYS: Final = 1 << 20  # fewer are sorted in less time than a busy machine's copies vary

FUSED_MULTIPLY_SHADER: Final = """
@group(0) @binding(0) var<storage, read_write> made: array<vec4f>;
@compute @workgroup_size(256)
fn fused(@builtin(global_invocation_id) at: vec3u) {
    var x: array<vec4f, 8>;
    for (var k = 0u; k < 8u; k++) { x[k] = vec4f(f32(at.x + k)) * 1e-9; }
    let a = vec4f(0.999);
    for (var i = 0u; i < LOOPS; i++) {
        x[0] = fma(x[0], a, x[1]); x[1] = fma(x[1], a, x[2]); x[2] = fma(x[2], a, x[3]);
        x[3] = fma(x[3], a, x[4]); x[4] = fma(x[4], a, x[5]); x[5] = fma(x[5], a, x[6]);
        x[6] = fma(x[6], a, x[7]); x[7] = fma(x[7], a, x[0]);
    }
    made[at.x % arrayLength(&made)] = x[0] + x[1] + x[2] + x[3] + x[4] + x[5] + x[6] + x[7];
}
"""


def crowd(n: int, camera: Camera, degree: int) -> SplatData:
    """Return Gaussians of about a pixel, at depths of 1 to 30, a share of them beside the image.

    A splat touches about two tiles, as those of trained scenes of millions do at this size.
    """
    rng = np.random.default_rng(0)
    rows = np.empty((n, 10), np.float32)
    z = np.exp(rng.uniform(0, np.log(30), n))
    spread = rng.uniform(-0.5, 0.5, (n, 2)) / np.sqrt(IN_IMAGE)
    pixel = 1 / camera.fx
    rows[:, 0] = spread[:, 0] * camera.width * pixel * z
    rows[:, 1] = spread[:, 1] * camera.height * pixel * z
    rows[:, 2], rows[:, 3] = z, rng.beta(1.2, 0.8, n)
    step = 1 << 19
    for first in range(0, n, step):  # in parts: covariances are worked out in float64
        part = slice(first, min(first + step, n))
        count = part.stop - first
        scale = 0.9 * pixel * z[part, None] * np.exp(0.6 * rng.normal(size=(count, 3)))
        scale[:, 2] *= 0.3
        rows[part, 4:] = covariance_upper(scale, rng.normal(size=(count, 4)))
    color = rng.standard_normal((n, 3 * (degree + 1) ** 2), dtype=np.float32)
    color *= np.float32(0.15)
    color[:, 0:3] += np.float32(0.5) * np.sin(3 * spread[:, :1] + [0, 2, 4]).astype(np.float32)
    return SplatData(rows, color, "sh")


def seconds(device: Device, action: Callable[[Any], None], times: int = 5) -> float:
    """Return the median seconds of what ``action`` encodes, from submitting to having it done."""
    marker, durations = device.storage("marker", 16), []
    for number in range(times + 1):
        encoder = device.raw.create_command_encoder()
        action(encoder)
        start_time = time.perf_counter()
        device.raw.queue.submit([encoder.finish()])
        device.read(marker, np.uint32, 1)
        if number:
            durations.append(time.perf_counter() - start_time)
    return statistics.median(durations)


def copy_rate(device: Device) -> float:
    """Return bytes read and written in a second by copying a buffer."""
    size = min(1 << 30, device.largest_binding)
    size, times = (1 << 26, 2) if device.software else (size, 16)
    source, target = device.storage("source", size), device.storage("target", size)

    def copies(encoder: Any) -> None:
        for _ in range(times):
            encoder.copy_buffer_to_buffer(source, 0, target, 0, size)

    return 2 * size * times / seconds(device, copies)


def flop_rate(device: Device) -> float:
    """Return float32 operations in a second, two for a fused multiplication and addition."""
    loops, groups = (64, 64) if device.software else (4096, 16384)
    raw = device.raw
    code = f"const LOOPS: u32 = {loops}u;\n" + FUSED_MULTIPLY_SHADER
    pipeline = raw.create_compute_pipeline(
        layout="auto", compute={"module": raw.create_shader_module(code=code)}
    )
    result = device.storage("made", 1 << 20)
    bind = raw.create_bind_group(
        layout=pipeline.get_bind_group_layout(0),
        entries=[{"binding": 0, "resource": {"buffer": result}}],
    )

    def loop(encoder: Any) -> None:
        compute = encoder.begin_compute_pass()
        compute.set_pipeline(pipeline)
        compute.set_bind_group(0, bind)
        compute.dispatch_workgroups(groups)
        compute.end()

    return 2 * 4 * CHAINS * loops * 256 * groups / seconds(device, loop)


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame that can be drawn again, with room for everything."""

    renderer: Renderer
    plan: Plan
    placed: list[PlacedPage]
    camera: Camera
    visible: int
    pairs: int

    @classmethod
    def of(cls, renderer: Renderer, scene: Scene, camera: Camera) -> "Frame":
        for _ in range(WARM_UP_FRAMES):
            drawn = renderer.draw(scene, camera)
        placed = renderer.placed(scene)
        plan = renderer.plan(placed, camera, frozenset({"color"}))
        return cls(renderer, plan, placed, camera, drawn.visible, drawn.pairs)

    def stages(self, frames: int) -> dict[str, dict[str, float]]:
        """Return the milliseconds of each stage, median and 95th percentile, by timestamps."""
        device = self.renderer.device
        if not device.has_clock:
            return {}
        clock = StageClock(device)
        message = list[dict[str, float]]()
        for number in range(frames + WARM_UP_FRAMES):
            self.plan.submit(self.placed, self.camera, NOTHING, clock=clock, fetch=False)
            self.plan.collect(fetch=False)
            if number >= WARM_UP_FRAMES:
                message.append(clock.seconds())
        for first in message:
            first["sum"] = sum(first.values())
        return {
            name: {
                "p50": 1e3 * float(np.median([entry[name] for entry in message])),
                "p95": 1e3 * float(np.percentile([entry[name] for entry in message], 95)),
            }
            for name in message[0]
        }

    def wall(self, frames: int) -> float:
        """Return the milliseconds of a frame when many follow each other."""
        start_time = time.perf_counter()
        for _ in range(frames):
            self.plan.submit(self.placed, self.camera, NOTHING, fetch=False)
        self.plan.collect(fetch=False)
        return 1e3 * (time.perf_counter() - start_time) / frames

    def unwaited(self, scene: Scene, frames: int) -> dict[str, float]:
        """Return the milliseconds of a frame of a window, and those that the host waits in it."""
        waited, start_time = [], time.perf_counter()
        for _ in range(frames):
            self.renderer.draw(scene, self.camera, wait=False)
            waited.append(self.renderer.late_counts.wait_seconds)
        elapsed = time.perf_counter() - start_time
        self.renderer.settle()
        return {"frame": 1e3 * elapsed / frames, "waited": 1e3 * float(np.median(waited))}

    def rows_bytes(self) -> tuple[int, int]:
        """Return the bytes of a row and of its appearance."""
        rows = sum(page.capacity for _, page in self.placed)
        return (
            sum(page.rows.size for _, page in self.placed) // rows,
            sum(page.appearance.size for _, page in self.placed) // rows,
        )


def minimum_times(
    frame: Frame, gaussians: int, bytes_a_second: float, flops: float
) -> dict[str, Any]:
    """Return the least milliseconds of each stage: its bytes once, and blending's operations.

    Bytes are those of the stages as they are built: 32-bit keys, splats of 48 bytes, tiles of the
    device's size. The operations
    are those of every pixel of every tile with every splat of its list, which is more than has to
    be done: finished pixels stop.
    """
    row, appearance = frame.rows_bytes()
    pixels = frame.camera.width * frame.camera.height
    visible, pairs = frame.visible, frame.pairs
    cut = frame.renderer._kernels.sort_config
    passes, pair_bytes = -(-32 // cut.digit_bits), 16 if cut.is_staged else 20
    last = -(-frame.camera.width // cut.tile) * -(-frame.camera.height // cut.tile) - 1
    grouping = -(-last.bit_length() // cut.digit_bits)
    amounts = {
        "project": gaussians * (row + 8) + visible * (appearance + 48),
        "sort": gaussians * 8 + visible * (8 + (passes - 1) * pair_bytes),
    }
    if pairs:
        amounts |= {
            "bin": visible * (20 + 36) + pairs * 8,
            "group": pairs * (grouping * pair_bytes + 4),
            "blend": pairs * 52 + pixels * 16,
        }
    else:
        amounts["quads"] = visible * 52 + pixels * 16
    result: dict[str, Any] = {
        name: {"MB": amount / 1e6, "ms": 1e3 * amount / bytes_a_second}
        for name, amount in amounts.items()
    }
    result["sum"] = {"ms": sum(entry["ms"] for entry in result.values())}
    if pairs:
        pixel_operations = FLOPS_OF_A_PIXEL * pairs * cut.tile**2
        result["blend, operations at most"] = {
            "GFLOP": pixel_operations / 1e9,
            "ms": 1e3 * pixel_operations / flops,
        }
    return result


def cropped(camera: Camera, size: tuple[int, int]) -> tuple[Camera, int, int]:
    """Return the camera of the middle of the image, and where that begins: at a tile."""
    width, height = min(size[0], camera.width), min(size[1], camera.height)
    x = (camera.width - width) // 2 // TILE * TILE
    y = (camera.height - height) // 2 // TILE * TILE
    part = Camera(
        camera.view,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx - x,
        cy=camera.cy - y,
        width=width,
        height=height,
    )
    return part, x, y


def rows_near_view(data: SplatData, camera: Camera) -> SplatData:
    """Return the rows that can reach the camera's image: a bound on each ellipse, and more.

    A standard deviation is at most the root of the covariance's trace, and its image at most that
    by focal length over depth by the stretch at the image's edge, which is less than 2 here.
    """
    x, y, z = data.rows[:, :3].astype(np.float64).T
    sigma = np.sqrt(data.rows[:, [4, 7, 9]].astype(np.float64).sum(axis=1))
    reach = 2 * 3.4 * (camera.fx * sigma / z + 1) + 2
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    retained = (
        (u > -reach) & (u < camera.width + reach) & (v > -reach) & (v < camera.height + reach)
    )
    return SplatData(data.rows[retained], data.appearance[retained], "sh")


def decibels(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(max(np.square(a - b).mean(), 1e-20)))


class Exactness:
    """A crop of the image by the float64 oracle, and what each renderer differs from it."""

    def __init__(self, scene: Scene, camera: Camera) -> None:
        self.scene = scene
        self.camera, self.x, self.y = cropped(camera, CROP)
        visible_rows = rows_near_view(scene.sets[0].data, self.camera)
        self.gaussians = len(visible_rows)
        start_time = time.perf_counter()
        self.wanted = oracle.render(Scene([visible_rows]), self.camera)
        self.seconds = time.perf_counter() - start_time

    def of(self, renderer: Renderer, whole: np.ndarray) -> dict[str, float]:
        """Return decibels and errors; of the same crop of the whole image, too."""
        actual = renderer.render(self.scene, self.camera).rgba
        assert actual is not None
        error = np.abs(actual - self.wanted.rgba).max(axis=-1)
        part = whole[self.y : self.y + self.camera.height, self.x : self.x + self.camera.width]
        return {
            "dB": decibels(actual, self.wanted.rgba),
            "largest error": float(error.max()),
            "largest error where no threshold is met": float(
                np.where(self.wanted.fragile, 0, error).max()
            ),
            "dB of the same part of the whole image": decibels(part, self.wanted.rgba),
        }


def sorting(device: Device, n: int) -> dict[str, Any]:
    """Sort depths of ``n`` Gaussians; say how many a second, and whether NumPy agrees."""
    cut = sort_config_for(device)
    keys = np.random.default_rng(0).uniform(0.01, 100, n).astype(np.float32).view(np.uint32)
    sort = RadixSort(device, cut, Scan(device, cut.block, 64, 256))
    counts = device.storage("counts", counting.COUNTERS_BYTES, extra_usage="INDIRECT")
    columns = [
        Columns(device.storage("keys", 4 * n), device.storage("values", 4 * n)) for _ in range(2)
    ]
    source = device.storage("unsorted", 4 * n)
    device.write(source, keys)
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

    def copy(encoder: Any) -> None:
        encoder.copy_buffer_to_buffer(source, 0, columns[0].keys, 0, 4 * n)

    def both(encoder: Any) -> None:
        copy(encoder)
        run(encoder, steps, "sort")

    durations = seconds(device, both) - seconds(device, copy)
    expected = sort_reference(keys, 32)
    same = bool((device.read(columns[result_index].values, np.uint32, n) == expected).all())
    if not same:
        raise AssertionError(f"{n:,} keys are not sorted as NumPy sorts them")
    if durations <= 0:
        raise AssertionError(f"copying {n:,} keys took longer than copying and sorting them")
    return {"keys": n, "ms": 1e3 * durations, "million keys a second": n / durations / 1e6}


def save(path: Path, rgba: np.ndarray) -> None:
    from PIL import Image

    whole = (np.clip(rgba[..., :3], 0, 1) * 255 + 0.5).astype(np.uint8)
    Image.fromarray(whole).save(path)


class Report:
    """What was measured so far; written after every part, so that a stop loses little."""

    def __init__(self, path: Path) -> None:
        self.path, self.made = path, dict[str, Any]()
        self.failed = dict[str, str]()

    def part(self, name: str, measure: Callable[[], Any]) -> Any:
        print_line(f"{name} …")
        start_time = time.perf_counter()
        try:
            self.made[name] = measure()
        except Exception as error:  # the parts after it are measured all the same
            traceback.print_exc()
            self.failed[name] = f"{type(error).__name__}: {error}"
        print_line(f"  {json.dumps(self.made.get(name), ensure_ascii=False)}")
        print_line(f"  {time.perf_counter() - start_time:.1f} s")
        text = json.dumps(self.made | {"failed": self.failed}, indent=2, ensure_ascii=False)
        self.path.write_text(text + "\n", "utf-8")
        return self.made.get(name)


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=6_060_000)
    parser.add_argument("--size", default="1920x1080", help="WIDTHxHEIGHT")
    parser.add_argument("--degree", type=int, default=3, choices=range(4))
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--modes", default=",".join(MODES).replace(", ", " "), help="Of these.")
    parser.add_argument("--out", default=os.environ.get("OUT") or ROOT / "out" / "gpu")
    return parser.parse_args()


def main() -> int:
    words = parse_arguments()
    width, height = map(int, words.size.split("x"))
    modes = [word.strip().replace(" compact", ", compact") for word in words.modes.split(",")]
    out = Path(words.out)
    out.mkdir(parents=True, exist_ok=True)
    report = Report(out / "gpu.json")
    device = Device.open()
    report.part(
        "device",
        lambda: {
            "adapter": {k: str(v) for k, v in dict(device.raw.adapter.info).items()},
            "largest binding": device.largest_binding,
            "timestamps": device.has_clock,
            "blends floats": device.blends_floats,
            "subgroups": device.subgroups,
            "kernels": asdict(sort_config_for(device)),
        },
    )
    bytes_a_second = report.part("bytes a second, copied", lambda: copy_rate(device))
    flops = report.part("operations a second", lambda: flop_rate(device))
    report.part("counted, 6.06 M", lambda: frame_traffic.table(frame_traffic.Workload()))
    report.part("sort", lambda: sorting(device, max(words.gaussians, LEAST_KEYS)))
    report.part("probe", lambda: _probed(device))
    camera = splat_scenes.camera(width, height, fx=0.8 * width, fy=0.8 * width)
    print_line(f"{words.gaussians:,} Gaussians of degree {words.degree}")
    scene = Scene([crowd(words.gaussians, camera, words.degree)])
    exactness = Exactness(scene, camera)
    save(out / "gpu_crop_oracle.png", exactness.wanted.rgba)
    print_line(f"oracle of {exactness.gaussians:,} Gaussians: {exactness.seconds:.0f} s")

    def measured(mode: str) -> dict[str, Any]:
        renderer = Renderer(device, **MODES[mode])
        frame = Frame.of(renderer, scene, camera)
        stages, wall = frame.stages(words.frames), frame.wall(words.frames)
        whole = renderer.render(scene, camera).rgba
        assert whole is not None
        save(out / f"gpu_{mode.replace(', ', '_')}.png", whole)
        return {
            "visible": frame.visible,
            "pairs": frame.pairs,
            "stages, ms": stages,
            "frame, ms of wall": wall,
            "frame of a window, ms": frame.unwaited(scene, words.frames),
            "floor": minimum_times(frame, words.gaussians, bytes_a_second, flops),
            "beside the oracle": exactness.of(renderer, whole),
        }

    report.part(
        "gsplat, ms",
        lambda: gsplat_milliseconds(scene.sets[0].data, camera, WARM_UP_FRAMES, words.frames),
    )
    for mode in modes:
        report.part(mode, lambda mode=mode: measured(mode))
    return 1 if report.failed else 0


def _probed(device: Device) -> dict[str, Any]:
    timings = rasteriser_choice.measure_options(device, Kernels(device))
    return {
        "tiles, ms": 1e3 * timings.tiles,
        "quads, ms": 1e3 * timings.quads,
        "small tiles, ms": 1e3 * timings.small_tiles,
        "tile, pixels": timings.tile,
        "best": timings.fastest_rasteriser,
    }


if __name__ == "__main__":
    sys.exit(main())
