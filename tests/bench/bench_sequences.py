"""Clips of several kinds of sequences: python tests/bench/bench_sequences.py [KIND…] [--full].

Makes sequences by formula (a smooth deformation, a skinned person, births and deaths; and the first
with its rows shuffled in each frame), or bakes those of a generator with a time (KIND is its file,
or a plugin whose demo is exported), exports them by the program, and prints bytes, errors and costs.
Bars at 300 frames: bytes at most 6 % of those of SOG frames, and, at the same error, 0.6 times those
of zipped deltas and of SPZ frames; PSNR at least 38 dB in the mean and 34 dB in the worst moment; a
frame's decoding at most 3 times the product of the same tables alone, one thread; memory of a loaded clip at
most 1.3 times its file; encoding at most 1 second of the processor a frame. With --segments, a page
shows the first frame of a scene file after at most 1.5 times the bytes of a SOG frame.

The bars are of 100,000 rows and 300 frames (--full); usual are fewer, which a laptop measures in
minutes. A generator has its own rows. A clip of 60 MB: person --rows 450000 --frames 60 --quality 80
--segments --alone
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

import numpy as np
import onnx
import onnx.parser
import onnx_ir as ir
import onnxruntime
from onnx_ir.passes.common import RemoveUnusedNodesPass
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1]))

from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest_io import loads
from gsgen.formats import Splats, open_splats, read_spz, write_ply, write_sog, write_spz
from gsgen.formats.shared.quantities import SH_C0
from gsgen.reference_plugins.sequences.clip_loss import camera_around, draw_rows
from gsgen.reference_plugins.static.static import from_content
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.frame import psnr
from gsgen.sdk.plugins.plugin import installed_plugins
from support.browser import GPU_FLAGS, GatedBytes, launched, require_chromium, serving
from support.measures import print_line
from support.web.pages import CLIENT

_PROGRAM = Path(sys.executable).with_name("gsgen")
_SIZE = 0.012
_JOINTS, _PARENTS = 16, (-1, 0, 1, 2, 1, 4, 5, 1, 7, 8, 0, 10, 11, 0, 13, 14)
_SAMPLED_FRAMES = 3
_ROUNDS = 15
# Powers of two of the steps that numbers of rivals are rounded to, and how often they are halved.
_FINEST, _COARSEST, _HALVINGS = -10.0, 1.0, 7
_PAGE = b"""<!doctype html><meta charset=utf-8>
  <style>gsgen-scene { width: 320px; height: 240px; aspect-ratio: auto }</style>
  <script type=module src=/client/scene.js></script><gsgen-scene src=/clip.json></gsgen-scene>"""
_SMALL_MODEL = """<ir_version: 8, opset_import: ["": 18]>
small (float[1] time) => (float[1] result) { result = Add (time, time) }"""
_LOAD = """
import resource, sys, numpy, onnxruntime
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()
settings = onnxruntime.SessionOptions()
settings.intra_op_num_threads = 1
def opened(path):
    return onnxruntime.InferenceSession(path, settings, providers=["CPUExecutionProvider"])
moment = {"time": numpy.array([0.5], numpy.float32)}
small = opened(sys.argv[2])  # the library's own memory counts before
small.run(None, moment)
start = resident()
session = opened(sys.argv[1])
loaded = resident() - start
session.run(None, moment)
print(loaded, resident() - start)
"""


def _cloud(rows: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return logarithms of scales, rotations and opacities of Gaussians."""
    log_scale = rng.normal(np.log(_SIZE), 0.4, (rows, 3))
    return log_scale, Rotation.random(rows, random_state=1), rng.uniform(0.5, 0.99, rows)


def _splats(
    position: np.ndarray,
    log_scale: np.ndarray,
    rotation: Rotation,
    opacity: np.ndarray,
    color: np.ndarray,
) -> Splats:
    logit = np.log(np.clip(opacity, 1e-6, 1 - 1e-6))
    logit -= np.log1p(-np.clip(opacity, 1e-6, 1 - 1e-6))
    return Splats(
        position=position.astype(np.float32),
        log_scale=log_scale.astype(np.float32),
        rotation=rotation.as_quat()[:, [3, 0, 1, 2]].astype(np.float32),
        logit_opacity=logit.astype(np.float32),
        sh=((color[:, None] - 0.5) / SH_C0).astype(np.float32),
    )


def _deformation(rows: int, frames: int) -> Iterator[Splats]:
    """A cloud that twists and waves."""
    rng = np.random.default_rng(1)
    start, color = rng.normal(size=(rows, 3)) * (1, 0.5, 1), rng.uniform(size=(rows, 3))
    log_scale, rotation, opacity = _cloud(rows, rng)
    for number in range(frames):
        phase = 2 * np.pi * number / frames
        turn = Rotation.from_rotvec(
            np.stack([0 * start[:, 1], 0.6 * np.sin(phase) * start[:, 1], 0 * start[:, 1]], axis=1)
        )
        wave = 0.15 * np.sin(phase + 2 * start[:, 0]) + 0.05 * np.sin(2 * phase + 7 * start[:, 2])
        position = turn.apply(start) + wave[:, None] * (0, 1, 0)
        yield _splats(position, log_scale, turn * rotation, opacity, color)


def _person(rows: int, frames: int) -> Iterator[Splats]:
    """Sixteen joints that swing, with Gaussians that follow two of them each."""
    rng = np.random.default_rng(2)
    rest = rng.normal(size=(_JOINTS, 3)) * 0.12
    rest[:, 1] -= np.linspace(0, 0.5, _JOINTS)
    axes = rng.normal(size=(_JOINTS, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    phases = rng.uniform(0, 2 * np.pi, (_JOINTS, 2))
    joint, share = rng.integers(0, _JOINTS, rows), rng.uniform(0, 0.5, rows)
    start = rest[joint] + 0.08 * rng.normal(size=(rows, 3))
    color = 0.5 + 0.5 * np.cos(9 * start)
    log_scale, rotation, opacity = _cloud(rows, rng)
    parent = np.maximum(np.array(_PARENTS), 0)[joint]
    for number in range(frames):
        phase = 4 * np.pi * number / frames
        bones = np.zeros((_JOINTS, 4, 4))
        for index, before in enumerate(_PARENTS):
            angle = 0.5 * np.sin(phase + phases[index, 0]) + 0.3 * np.sin(
                2 * phase + phases[index, 1]
            )
            turn = Rotation.from_rotvec(angle * axes[index]).as_matrix()
            own = np.eye(4)
            own[:3, :3], own[:3, 3] = turn, rest[index] - turn @ rest[index]
            bones[index] = own if before < 0 else bones[before] @ own
        blend = (1 - share)[:, None, None] * bones[joint] + share[:, None, None] * bones[parent]
        position = np.einsum("nij,nj->ni", blend[:, :3, :3], start) + blend[:, :3, 3]
        turned = Rotation.from_matrix(blend[:, :3, :3]) * rotation
        yield _splats(position, log_scale, turned, opacity, color)


def _births(rows: int, frames: int) -> Iterator[Splats]:
    """A vortex in which half of the Gaussians are born and die."""
    rng = np.random.default_rng(3)
    start, color = rng.normal(size=(rows, 3)) * (1, 0.5, 1), rng.uniform(size=(rows, 3))
    log_scale, rotation, opacity = _cloud(rows, rng)
    birth = np.where(np.arange(rows) < rows // 2, -1, rng.uniform(-0.6, 1, rows))
    life = np.where(birth < -0.9, 3, 0.5)
    for number in range(frames):
        moment = number / max(frames - 1, 1)
        angle = 1.6 * moment * (1.4 - np.linalg.norm(start[:, [0, 2]], axis=1))
        turn = Rotation.from_rotvec(np.stack([0 * angle, angle, 0 * angle], axis=1))
        wave = 0.15 * np.sin(6 * moment + 2 * start[:, 0])
        window = np.clip(1 - np.abs((moment - birth) / life - 0.5) * 2, 0, 1) ** 0.5
        position = turn.apply(start) + wave[:, None] * (0, 1, 0)
        yield _splats(position, log_scale, turn * rotation, opacity * window, color)


def _shuffled(rows: int, frames: int) -> Iterator[Splats]:
    """The deformation, its rows in another order in each frame."""
    rng = np.random.default_rng(4)
    for frame in _deformation(rows, frames):
        order = rng.permutation(rows)
        yield Splats(
            position=frame.position[order],
            log_scale=frame.log_scale[order],
            rotation=frame.rotation[order],
            logit_opacity=frame.logit_opacity[order],
            sh=frame.sh[order],
        )


def _columns(splats: Splats) -> np.ndarray:
    """Return the numbers of a PLY, one row a Gaussian."""
    parts = [splats.position, splats.log_scale, splats.rotation, splats.logit_opacity[:, None]]
    return np.concatenate([*parts, splats.sh.reshape(len(splats), -1)], axis=1)


def _steps(splats: Splats) -> np.ndarray:
    """Return a step of each column that shows about as much as those of the others.

    They are a radius, a factor e of a scale, half a radian, the opacity's logit, a colour.
    """
    radius = float(np.exp(np.median(splats.log_scale)))
    sh = splats.sh[0].size
    return np.concatenate([[radius] * 3, [1] * 3, [0.5] * 4, [2], [1 / SH_C0 / 2] * sh])


def _rounded(splats: Splats, step: float) -> tuple[np.ndarray, Splats]:
    """Return the whole numbers of rounded columns, and what they stand for."""
    steps = step * _steps(splats)
    whole = np.rint(_columns(splats) / steps).astype(np.int32)
    columns = (whole * steps).astype(np.float32)
    return whole, Splats(
        position=columns[:, :3],
        log_scale=columns[:, 3:6],
        rotation=columns[:, 6:10],
        logit_opacity=columns[:, 10],
        sh=columns[:, 11:].reshape(splats.sh.shape),
    )


def _delta(first: Splats, second: Splats, step: float) -> tuple[int, Splats]:
    """Return the bytes of the difference of two frames, zipped by column and byte; the second frame."""
    (before, _), (after, drawn) = (_rounded(frame, step) for frame in (first, second))
    change = after - before if before.shape == after.shape else after
    planes = np.ascontiguousarray(change.T)[..., None].view(np.uint8).transpose(0, 2, 1)
    return len(zlib.compress(planes.tobytes(), 9)), drawn


def _spz(_: Splats, splats: Splats, step: float) -> tuple[int, Splats]:
    """Return the zipped bytes of a frame as SPZ, and the frame."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.spz"
        write_spz(path, _rounded(splats, step)[1])
        return len(zlib.compress(path.read_bytes(), 9)), read_spz(path)


def _at_equal_error(source: list[Path], goal: float) -> dict[str, tuple[float, float]]:
    """Return the bytes of all frames in other forms, and the PSNR of those.

    The numbers of a form are rounded to the largest steps at which some frames are drawn with the
    PSNR ``goal``, those of the clip; SPZ may not reach it.
    """
    renderer = Renderer()
    numbers = np.linspace(1, len(source) - 1, _SAMPLED_FRAMES).astype(int)
    pairs = []
    for number in numbers:
        pair = [open_splats(source[index]) for index in (number - 1, number)]
        pairs.append([frame for frame in pair if isinstance(frame, Splats)])
    camera = camera_around([from_content(second) for _, second in pairs])
    expected = [draw_rows(renderer, from_content(second), camera) for _, second in pairs]

    def measure(form: Callable[[Splats, Splats, float], tuple[int, Splats]], power: float):  # type: ignore[no-untyped-def]
        results = [form(first, second, 2.0**power) for first, second in pairs]
        ratios = [
            psnr(draw_rows(renderer, from_content(drawn), camera), picture)
            for (_, drawn), picture in zip(results, expected, strict=True)
        ]
        size = float(np.mean([size for size, _ in results])) * len(source)
        return size, float(np.mean(ratios))

    found = {}
    for name, form in (("deltas", _delta), ("SPZ", _spz)):
        low, high = _FINEST, _COARSEST
        best = measure(form, low)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            result = measure(form, middle)
            if result[1] >= goal:
                low, best = middle, result
            else:
                high = middle
        found[name] = best
    return found


_KINDS: dict[str, Callable[[int, int], Iterator[Splats]]] = {
    "deformation": _deformation,
    "person": _person,
    "births": _births,
    "shuffled": _shuffled,
}


def _generator(kind: str, folder: Path) -> Path:
    """Return a generator's file: the one named, or the export of a plugin's demo."""
    if kind.endswith(".onnx"):
        return Path(kind)
    (plugin,) = (plugin for plugin in installed_plugins() if plugin.name == kind)
    assert plugin.demo is not None, f"{kind} has no demo"
    run = folder / "checkpoint"
    run.mkdir()
    command = ["export", kind, *plugin.demo.write(run), "-o", str(folder / "model.onnx")]
    subprocess.run([_PROGRAM, *command, "--level", "static"], check=True, capture_output=True)
    return folder / "model.onnx"


def _baked(generator: Path) -> Callable[[int, int], Iterator[Splats]]:
    """Return the frames of a generator, over the range of its time."""

    def frames_of(_: int, frames: int) -> Iterator[Splats]:
        text = open_model(generator).manifest_text
        assert text is not None
        spans = [entry.range for entry in loads(text).inputs if entry.role == "time"]
        low, high = spans[0] or (0.0, 1.0)
        last = low + (high - low) * (frames - 1) / frames
        with tempfile.TemporaryDirectory() as folder:
            moments = f"{low}:{last}:{frames}"
            command = [str(_PROGRAM), "bake", str(generator), "-o", f"{folder}/%04d.ply"]
            subprocess.run([*command, "--time", moments], check=True, capture_output=True)
            for path in sorted(Path(folder).iterdir()):
                content = open_splats(path)
                assert isinstance(content, Splats)
                yield content

    return frames_of


def _write_frames(kind: str, rows: int, frames: int, folder: Path) -> float:
    """Write a sequence as PLYs, and return the bytes of all frames as SOG, of which three are written."""
    sampled = set(np.linspace(0, frames - 1, _SAMPLED_FRAMES).astype(int).tolist())
    total = 0.0
    make = _KINDS[kind] if kind in _KINDS else _baked(_generator(kind, folder.parent))
    for number, splats in enumerate(make(rows, frames)):
        write_ply(folder / f"{number:04d}.ply", splats)
        if number in sampled:
            path = folder.parent / "still.sog"
            write_sog(path, splats)
            total += len(zlib.compress(path.read_bytes())) * frames / len(sampled)
    return total


def _bare_product(clip: Path) -> bytes:
    """Return a model that dequantises the tables of a clip, and multiplies them, and no more."""
    model = ir.load(clip)
    graph = model.graph
    products = [node for node in graph if node.op_type == "MatMul" and _is_table(node.inputs[1])]
    graph.outputs.clear()
    for number, node in enumerate(products):
        node.outputs[0].name = f"product_{number}"
        graph.outputs.append(node.outputs[0])
    for value in graph.outputs:
        value.type, value.shape = ir.TensorType(ir.DataType.FLOAT), None
    RemoveUnusedNodesPass()(model)
    model.metadata_props.clear()
    return ir.to_proto(model).SerializeToString()


def _is_table(value: ir.Value | None) -> bool:
    producer = None if value is None else value.producer()
    return producer is not None and producer.op_type == "DequantizeLinear"


def _seconds(model: Path | bytes) -> Callable[[], float]:
    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, settings, providers=["CPUExecutionProvider"])
    moments = np.linspace(0, 1, _ROUNDS, dtype=np.float32)
    count = iter(range(10**6))

    def run() -> float:
        moment = moments[next(count) % _ROUNDS]
        start = time.process_time()
        session.run(None, {"time": np.array([moment], np.float32)})
        return time.process_time() - start

    run()
    return run


def _bytes_of_first_picture(source: Path, folder: Path, options: list[str]) -> int:
    """Return the bytes of a clip after which a page shows it; other segments do not arrive."""
    scene = folder / "clip.json"
    command = ["export", "sequence", str(source), "-o", str(scene), *options, "--moments", "0"]
    subprocess.run([_PROGRAM, *command, "--level", "static"], check=True, capture_output=True)
    files = [scene, *sorted((folder / "clip").iterdir())]
    contents = {f"/{file.relative_to(folder)}": file.read_bytes() for file in files}
    first = [f"/{file.relative_to(folder)}" for file in files[:2]]
    later = {name: GatedBytes.of(data, 0) for name, data in contents.items() if name not in first}
    contents |= {"/page.html": _PAGE, **later}
    with (
        serving({"client": CLIENT}, contents) as address,
        launched(require_chromium(), GPU_FLAGS) as browser,
    ):
        page = browser.new_page()
        page.set_default_timeout(600_000)
        page.goto(f"{address}/page.html")
        page.wait_for_function("document.querySelector('gsgen-scene').state === 'ready'")
        for data in later.values():
            assert data.sent == 0
            data.gate.set()
    return sum(len(contents[name]) for name in first)


def _measure(
    kind: str,
    rows: int,
    frames: int,
    folder: Path,
    options: list[str],
    arguments: argparse.Namespace,
) -> None:
    source = folder / "frames"
    source.mkdir(parents=True)
    sog_bytes = _write_frames(kind, rows, frames, source)
    clip, report = folder / "clip.onnx", folder / "report.json"
    before = getrusage(RUSAGE_CHILDREN)
    command = ["gsgen", "export", "sequence", str(source), "-o", str(clip), *options]
    subprocess.run(
        [_PROGRAM, *command[1:], "--report", str(report)], check=True, capture_output=True
    )
    after = getrusage(RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    measured = json.loads(report.read_text("utf-8"))["measured"]
    rows, size, loss = measured["rows"], clip.stat().st_size, measured["loss"]
    # The two take turns, so that other programs disturb both alike.
    runs = [_seconds(clip), _seconds(_bare_product(clip))]
    times = np.array([[run() for run in runs] for _ in range(_ROUNDS)])
    whole, bare = np.median(times, axis=0)
    small = folder / "small.onnx"
    small.write_bytes(onnx.parser.parse_model(_SMALL_MODEL).SerializeToString())
    answer = subprocess.run(
        [sys.executable, "-c", _LOAD, str(clip), str(small)],
        check=True,
        capture_output=True,
        text=True,
    )
    loaded, first = (int(part) for part in answer.stdout.split())
    print_line(
        f"{kind}: {measured['rows']:,} rows, {frames} frames, {size:,} bytes "
        f"({size / rows:.1f} a Gaussian of a frame); {100 * size / sog_bytes:.1f} % of SOG frames "
        "(bar 6 at 300 frames)"
    )
    if arguments.segments:
        first_bytes = _bytes_of_first_picture(source, folder, options)
        print_line(
            f"  the first picture in a page after {first_bytes:,} bytes, "
            f"{first_bytes * frames / sog_bytes:.2f} × a SOG frame (bar 1.5)"
        )
    goal = loss["psnr_mean"]
    rivals = {} if arguments.alone else _at_equal_error(sorted(source.iterdir()), goal)
    for name, (other, ratio) in rivals.items():
        print_line(
            f"  {size / other:.3f} of the bytes of {name}, zipped, rounded to {ratio:.1f} dB where the "
            f"clip has {loss['psnr_mean']:.1f} (bar 0.6)"
        )
    print_line(
        f"  PSNR {loss['psnr_mean']:.1f} dB mean (bar 38), {loss['psnr_worst']:.1f} worst (bar 34); "
        f"decoding {1e3 * whole:.2f} ms, {whole / bare:.2f} × the bare product (bar 3); memory "
        f"{loaded / size:.2f} × the file loaded (bar 1.3), {first / size:.2f} after a frame"
    )
    print_line(
        f"  encoding {seconds / frames:.3f} CPU-s a frame, checks and pictures included (bar 1); "
        f"peak of all programs so far {after.ru_maxrss / 2**20:.2f} GiB (bar 2)"
    )
    print_line(f"  bytes: {measured['table_bytes']}")


def main() -> None:
    """Measure the kinds of sequences that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("kinds", nargs="*", default=list(_KINDS))
    parser.add_argument("--full", action="store_true", help="100,000 rows and 300 frames")
    parser.add_argument("--rows", type=int, default=6000)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--quality", type=int, default=75)
    parser.add_argument("--moments", type=int, default=8)
    parser.add_argument("--segments", action="store_true", help="and bytes until the first picture")
    parser.add_argument("--alone", action="store_true", help="without other forms")
    arguments = parser.parse_args()
    rows, frames = (100_000, 300) if arguments.full else (arguments.rows, arguments.frames)
    options = ["--quality", str(arguments.quality), "--moments", str(arguments.moments)]
    for kind in arguments.kinds:
        with tempfile.TemporaryDirectory() as folder:
            _measure(kind, rows, frames, Path(folder) / Path(kind).stem, options, arguments)


if __name__ == "__main__":
    main()
