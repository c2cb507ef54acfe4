"""Generators in other engines: milliseconds of a run and a fill of 20,000 rows, by WebAssembly."""

from pathlib import Path
from typing import Any

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.people.gauhuman_plugin import build
from gsgen.reference_plugins.synthetic import PersonOptions, write_gauhuman, write_motion
from gsgen.runtime.web.onnxruntime_web import ort_folder
from gsgen.sdk import export
from support.measures import print_figure
from support.web.engines import ENGINES, engine_pages
from support.web.without_webgpu import page_without_webgpu

GAUSSIANS, VERTICES = 20_000, 6_890
ROUNDS = 60
MAX_MILLISECONDS = 35

# Of the fastest twentieth of the frames, which other work on the machine disturbs least.
_TIMES = """async () => {
  const { time } = frames;
  const spent = [];
  for (let round = 0; round < ROUNDS; round++) {
    const value = time.low + ((round % 60) / 60) * (time.high - time.low);
    const start = performance.now();
    const frame = await frames.run({ [time.name]: value });
    const middle = performance.now();
    person.fill(frame, camera);
    spent.push([middle - start, performance.now() - middle, performance.now() - start]);
  }
  return [0, 1, 2].map((column) => spent.slice(20).map((row) => row[column]).sort((a, b) => a - b)[2]);
}""".replace("ROUNDS", str(ROUNDS))


def thread_seconds(session: Any) -> float:
    """Return the processor time that a page's main thread has taken, drawing included."""
    metrics = session.send("Performance.getMetrics")["metrics"]
    [seconds] = [metric["value"] for metric in metrics if metric["name"] == "ThreadTime"]
    return float(seconds)


def bench_a_frame_in_each_engine(tmp_path: Path) -> None:
    path = tmp_path / "walk.onnx"
    write_gauhuman(tmp_path / "run", PersonOptions(count=GAUSSIANS, vertices=VERTICES))
    motion = write_motion(tmp_path / "walk.npz", frames=24)
    generator = build(tmp_path / "run", motion=motion)
    export(generator, path, target="webgpu", settings=Settings(level=Level.STATIC))
    contents = engine_pages(tmp_path) | {"/walk.onnx": path.read_bytes()}
    with page_without_webgpu(contents, ort_folder(None)) as (page, address):
        for engine in ENGINES:
            page.goto(f"{address}/{engine}.html?provider=wasm")
            page.wait_for_function("window.walkTo")
            session = page.context.new_cdp_session(page)
            session.send("Performance.enable")
            start = thread_seconds(session)
            run, fill, both = page.evaluate(_TIMES)
            cpu = 1000 * (thread_seconds(session) - start) / ROUNDS
            print_figure(
                f"{engine}, {GAUSSIANS:,} rows: run {run:.1f} + fill {fill:.1f} = {both:.1f} ms, "
                f"{cpu:.1f} ms of the thread's processor time in the mean; bar {MAX_MILLISECONDS}"
            )
