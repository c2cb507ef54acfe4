"""Exports, validates and draws an example of every plugin, as a user would type it.

``make demo`` shows this after the garden; ``python docs/examples/demo_families.py OUT`` alone.
The checkpoints are synthetic, in the layout of each method's training code. What is shown comes
from the plugins themselves: those of other packages take part if they have a demo.
"""

# %%
import io
import json
import math
import os
import shlex
import shutil
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.metadata import entry_points
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console

from gsgen.sdk import Demo, Plugin, installed_plugins

TILE = (240, 240)  # width and height of each picture of a strip
FRAMES = 6
BACKGROUND = "#16181d"
# The options of `gsgen render` for each view. Frames go through time where the model has one.
VIEWS = {
    "orbit": "--camera orbit:20,30 --turn 300",
    "still": "--camera orbit:20,35",
    "person": "--camera orbit:-50,6,2.6 --up +y",
    "head": "--camera orbit:-150,5 --up +y --turn 140",
    "swing": "--camera orbit:-120,8 --turn 72",
}


def demo_plugins() -> dict[str, Plugin]:
    """Return the installed plugins that have a demo, by name."""
    return {plugin.name: plugin for plugin in installed_plugins() if plugin.demo}


def demo_of(plugin: Plugin) -> Demo:
    """Return the demo of a plugin that has one."""
    assert plugin.demo is not None, plugin.name
    return plugin.demo


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoModel:
    """The exported model of a plugin, and what was measured of it: a row of the table.

    Attributes:
        name: Name of the plugin.
        gaussians: Rows of the model; None for an image model.
        size: Bytes of the file.
        verdict: The verdict of ``gsgen validate``.
        level: The highest level that was checked here.
        milliseconds: Time of one frame on the CPU, the median of five.
        strip: The pictures side by side; None where no driver can draw.
        trouble: The reason for None.
    """

    name: str
    gaussians: int | None
    size: int
    verdict: str
    level: str
    milliseconds: float
    strip: Path | None
    trouble: str


# %% The command line, in this process: torch is imported once for all that it exports.


def gsgen(log: Path, *words: str) -> tuple[int, str, str]:
    """Run the program as its console script does; return exit code, stdout and stderr."""
    (script,) = entry_points(group="console_scripts", name="gsgen")
    main = script.load()
    stdout, stderr, arguments = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["gsgen", *words]
    try:
        with redirect_stdout(stdout), redirect_stderr(stderr):
            main()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0
    finally:
        sys.argv = arguments
    command = shlex.join(["gsgen", *words])
    with log.open("a", encoding="utf-8") as file:
        file.write(f"$ {command}\n{stderr.getvalue()}{stdout.getvalue()}\n")
    return code, stdout.getvalue(), stderr.getvalue()


def required(log: Path, *words: str) -> None:
    """Run the program; raise with its output if it fails."""
    code, stdout, stderr = gsgen(log, *words)
    if code:
        raise RuntimeError(f"gsgen {shlex.join(words)} ended with {code}\n{stdout}{stderr}")


def make(name: str, folder: Path) -> DemoModel:
    """Export, validate, time and draw a plugin's demo; ``commands.txt`` logs the commands."""
    plugin, log, model = (demo_plugins()[name], folder / "commands.txt", folder / f"{name}.onnx")
    run, report_file = folder / "run", folder / "report.json"
    # An earlier demo's checkpoint may have other files.
    shutil.rmtree(run, ignore_errors=True)
    run.mkdir(parents=True)
    log.write_text("", "utf-8")
    words = demo_of(plugin).write(run)
    # Image models take minutes on a software driver, Gaussians take seconds.
    level = "behaviour" if "image" in plugin.inputs else "live"
    checks = ("--level", level, "--report", str(report_file))
    required(log, "export", name, *words, "-o", str(model), *checks)
    report = json.loads(report_file.read_text("utf-8"))["validation"]
    strip, trouble = draw(plugin, model, folder, log)
    levels = [level["level"] for level in report["levels"] if level["status"] == "ran"]
    return DemoModel(
        name=name,
        gaussians=report["subject"].get("capacity"),
        size=model.stat().st_size,
        verdict=report["verdict"],
        level=levels[-1],
        milliseconds=frame_time(model),
        strip=strip,
        trouble=trouble,
    )


def works_on_images(plugin: Plugin) -> bool:
    """Whether the plugin's models process a drawn image, and make no Gaussians."""
    return "image" in plugin.inputs and demo_of(plugin).pictures is None


def enlargement(model: Path) -> int:
    """Return how many times as wide and high as its image the result of a post-process model is."""
    from gsgen.runtime import PostProcessor

    with PostProcessor(model) as processor:
        return processor.scale


def frame_time(model: Path) -> float:
    """Return milliseconds of a frame on the CPU, the median of five."""
    from gsgen.sdk.binding import FrameSession

    seconds = []
    with FrameSession(model, provider="cpu") as session:
        for _ in range(5):
            start = time.perf_counter()
            session.run()
            seconds.append(time.perf_counter() - start)
    return 1000 * sorted(seconds)[2]


# %% Pictures.


def draw(plugin: Plugin, model: Path, folder: Path, log: Path) -> tuple[Path | None, str]:
    """Draw a strip of six pictures; return its path, or None and the reason."""
    demo = demo_of(plugin)
    if demo.view == "recede":
        camera = ["--camera", str(write_receding_cameras(folder / "cameras.json"))]
    else:
        camera = VIEWS[demo.view].split()
    scene, count = str(model), FRAMES
    if works_on_images(plugin):  # it is shown on a static scene, in half as many frames
        (scene,), count = demo_of(demo_plugins()["static"]).write(folder), FRAMES // 2
    options = ["--frames", str(count), "--background", BACKGROUND, *camera]
    if demo.pictures is not None:
        options += ["--image", ",".join(map(str, demo.pictures(folder)))]
    try:
        pixel = enlargement(model) if works_on_images(plugin) else 1
        pictures = frames(scene, options, folder / "frames", log, pixel)
        if demo.degrade_image is not None:
            degraded = [demo.degrade_image(picture) for picture in pictures]
            pictures = alternating(degraded, [processed(model, image) for image in degraded])
        elif works_on_images(plugin):
            options += ["--post", str(model)]
            pictures = alternating(pictures, frames(scene, options, folder / "after", log))
    except NoAdapterError as error:
        return None, str(error)
    strip = folder.parent / f"{model.stem}.png"
    Image.fromarray(np.concatenate(pictures, axis=1)).save(strip)
    return strip, ""


class NoAdapterError(RuntimeError):
    """There is neither a GPU nor a software driver to draw with."""


def frames(
    scene: str, options: list[str], folder: Path, log: Path, pixel: int = 1
) -> list[np.ndarray]:
    """Draw a scene with ``gsgen render``, and return the pictures; ``pixel`` is a pixel's side."""
    shutil.rmtree(folder, ignore_errors=True)
    size = ["--width", str(TILE[0] // pixel), "--height", str(TILE[1] // pixel)]
    words = ("render", scene, "-o", str(folder), *size, *options)
    code, _, stderr = gsgen(log, *words)
    if code and "adapter" in stderr:
        raise NoAdapterError(stderr.strip())
    if code:
        raise RuntimeError(f"gsgen {shlex.join(words)} ended with {code}\n{stderr}")
    paths = sorted(folder.glob("frame_*.png"))
    pictures = [np.asarray(Image.open(path).convert("RGB")) for path in paths]
    return [picture.repeat(pixel, axis=0).repeat(pixel, axis=1) for picture in pictures]


def alternating(first: list[np.ndarray], second: list[np.ndarray]) -> list[np.ndarray]:
    """Return the pictures of two lists in turn."""
    return [picture for pair in zip(first, second, strict=True) for picture in pair]


def write_receding_cameras(path: Path) -> Path:
    """Write cameras that move away from the knot and zoom in, so that it keeps its size."""
    from gsgen.runtime import Camera

    cameras = []
    for distance in np.geomspace(6, 90, FRAMES):
        eye = distance * np.array([0.35, -0.5, -0.8])
        angle = 2 * math.degrees(math.atan(1.85 / distance))
        width, height = TILE
        camera = Camera.look_at(eye.tolist(), [0, 0, 0], width=width, height=height, fov_y=angle)
        lens = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
        size = {"width": width, "height": height}
        cameras.append({"view": camera.view.tolist(), **lens, **size})
    path.write_text(json.dumps(cameras), "utf-8")
    return path


def processed(model: Path, picture: np.ndarray) -> np.ndarray:
    """Run a post-process model over a picture."""
    import onnxruntime

    from gsgen.runtime import post_process

    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    image = np.moveaxis(picture, 2, 0)[None].astype(np.float32) / 255
    result: np.ndarray = np.moveaxis(post_process(session, image)[0], 0, 2)
    rounded: np.ndarray = (np.clip(result, 0, 1) * 255 + 0.5).astype(np.uint8)
    return rounded


# %%
def make_all(folder: Path, names: list[str]) -> list[DemoModel]:
    """Make the demos of several plugins, two at a time."""
    spawning = get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=spawning, initializer=limit_threads) as pool:
        return list(pool.map(make, names, [folder / name for name in names]))


def limit_threads() -> None:
    """Limit torch to one thread: two processes would wait for each other's."""
    os.environ["OMP_NUM_THREADS"] = "1"


def show(models: list[DemoModel], folder: Path, console: Console) -> None:
    """Print a table of the models, and where their pictures are."""
    console.print(table(models))
    for trouble in {model.trouble for model in models if model.trouble}:
        console.print(f"No pictures: {trouble}")
    console.print(f"Pictures: {folder}/NAME.png; commands: {folder}/NAME/commands.txt")


def table(models: list[DemoModel]) -> str:
    """Return a table of the models; the time of a frame is that on the CPU."""
    plugins = demo_plugins()
    lines = [f"{'plugin':<17}{'Gaussians':>10}{'file':>11}{'a frame':>10}  verdict"]
    for model in models:
        count = "–" if model.gaussians is None else f"{model.gaussians:,}"
        size, frame = f"{model.size / 1024:,.0f} KiB", f"{model.milliseconds:.1f} ms"
        caption = demo_of(plugins[model.name]).caption if model.strip else "not drawn"
        verdict = f"{model.verdict} ({model.level}); picture: {caption}"
        lines.append(f"{model.name:<17}{count:>10}{size:>11}{frame:>10}  {verdict}")
    return "\n".join(lines)


def main() -> None:
    """Show the demos of the plugins that are named, or of all."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo/families")
    known = demo_plugins()
    names = sys.argv[2:] or list(known)
    if unknown := [name for name in names if name not in known]:
        sys.exit(f"demo: {unknown[0]!r} has no demo; expected one of: {', '.join(known)}")
    show(make_all(folder, names), folder, Console(highlight=False, soft_wrap=True))


if __name__ == "__main__":
    main()
