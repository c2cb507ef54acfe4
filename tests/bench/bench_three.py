"""Generators in three.js without WebGPU: seconds of a frame, and pictures beside Python's."""

from pathlib import Path

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.people.gauhuman_plugin import build
from gsgen.reference_plugins.synthetic import PersonOptions, write_gauhuman, write_motion
from gsgen.runtime.baking import bake
from gsgen.runtime.checks.level import scene_of
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.web.onnxruntime_web import ort_folder
from gsgen.sdk import export
from gsgen.sdk.binding import FrameSession
from support.measures import print_figure
from support.web.without_webgpu import (
    element_picture,
    frame_picture,
    frames_page,
    page_of,
    page_without_webgpu,
    python_picture,
)

GAUSSIANS, VERTICES = 20_000, 6_890
MAX_MILLISECONDS = 12
MIN_ELEMENT_DECIBELS = 32
MAX_LOSS_DECIBELS = 1
SHARES = (0.1, 0.4, 0.8)

_TIMES = """async () => {
  const { time } = frames;
  const spent = [];
  for (let round = 0; round < 120; round++) {
    const value = time.low + ((round % 60) / 60) * (time.high - time.low);
    const start = performance.now();
    const frame = await frames.run({ [time.name]: value });
    const middle = performance.now();
    person.fill(frame);
    spent.push([middle - start, performance.now() - middle, performance.now() - start]);
  }
  const ordered = (column) => spent.slice(20).map((row) => row[column]).sort((a, b) => a - b);
  return [ordered(0)[5], ordered(1)[5], ordered(2)[5], ordered(2)[50]];
}"""


def bench_a_person_without_webgpu(tmp_path: Path) -> None:
    path = tmp_path / "walk.onnx"
    write_gauhuman(tmp_path / "run", PersonOptions(count=GAUSSIANS, vertices=VERTICES))
    motion = write_motion(tmp_path / "walk.npz", frames=24)
    generator = build(tmp_path / "run", motion=motion)
    export(generator, path, target="webgpu", settings=Settings(level=Level.STATIC))
    contents = {"/walk.onnx": path.read_bytes(), "/none.html": b"<!doctype html>"}
    contents["/element.html"] = page_of("<gsgen-model src=/walk.onnx></gsgen-model>")
    for number, share in enumerate(SHARES):
        bake(path, tmp_path / "frame.ply", time=share)
        contents[f"/{number}.ply"] = (tmp_path / "frame.ply").read_bytes()
    example = frames_page(contents)
    with (
        page_without_webgpu(contents, ort_folder(None)) as (page, address),
        FrameSession(path, provider="cpu") as session,
    ):
        assert isinstance(session.manifest, GeneratorManifest)
        scenes = []
        for share in SHARES:
            outputs = session.run({"time": share}, copy=True)
            scenes.append(scene_of(session.manifest, {name: outputs[name] for name in outputs}))
        page.goto(f"{address}{example}")
        page.wait_for_function("window.walkTo")
        run, fill, both, median = page.evaluate(_TIMES)
        print_figure(
            f"{GAUSSIANS:,} rows, the fastest twentieth: run {run:.1f} + fill {fill:.1f} = {both:.1f} ms; "
            f"bar {MAX_MILLISECONDS}; median {median:.1f}"
        )
        for number, share in enumerate(SHARES):
            image, camera = frame_picture(page, share)
            baked, _ = frame_picture(page, share, f"/{number}.ply")
            expected = python_picture(scenes[number], camera)
            ours, theirs = psnr(image, expected), psnr(baked, expected)
            print_figure(f"time {share}: {ours:.1f} dB, {theirs:.1f} dB by the baked PLY")
            assert ours >= theirs - MAX_LOSS_DECIBELS
        page.goto(f"{address}/element.html")
        page.wait_for_function("document.querySelector('gsgen-model').report")
        for share, scene in zip(SHARES, scenes, strict=True):
            image, camera = element_picture(page, share)
            decibels = psnr(image, python_picture(scene, camera))
            print_figure(f"element at time {share}: {decibels:.1f} dB")
            assert decibels >= MIN_ELEMENT_DECIBELS
