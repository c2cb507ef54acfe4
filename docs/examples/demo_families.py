"""Every family of methods: a checkpoint is exported, judged and drawn, as a user would type it.

``make demo`` shows this after the garden; ``python docs/examples/demo_families.py OUT`` alone.
The checkpoints are made up, in the layout of each method's training code.
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
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console

TILE = (240, 240)  # width and height of each picture of a strip
FRAMES = 6
BACKGROUND = "#16181d"


@dataclass(frozen=True, slots=True)
class Family:
    """How a family is shown.

    Attributes:
        write: Writes a checkpoint into a folder, and returns what ``gsgen export`` is told of it.
        camera: Options of ``gsgen render``; frames go through time where the model has one.
        shows: What differs from picture to picture.
        images: Whether the model works on images.
        tried_on: Makes what such a model is tried on of a drawn image; the image itself without.
    """

    write: Callable[[Path], list[str]]
    camera: str
    shows: str
    images: bool = False
    tried_on: Callable[[np.ndarray], np.ndarray] | None = None


@dataclass(frozen=True, slots=True)
class DemoModel:
    """What became of a family: a line of the table.

    Attributes:
        name: Of the family.
        gaussians: Rows of the model; None where it makes none.
        size: Bytes of the file.
        verdict: Of ``gsgen validate``.
        level: The highest that could be judged here.
        milliseconds: Of one frame on the CPU, the median of five.
        strip: The pictures side by side; None where nothing can be drawn.
        trouble: Why not.
    """

    name: str
    gaussians: int | None
    size: int
    verdict: str
    level: str
    milliseconds: float
    strip: Path | None
    trouble: str


# %% Checkpoints. What needs torch is imported where it is used: the table is shown without.


def static(run: Path) -> list[str]:
    """Write a splat file."""
    from gsgen.formats import write_ply
    from gsgen.reference_plugins.synthetic import torus_knot

    write_ply(run / "knot.ply", torus_knot(20_000))
    return [str(run / "knot.ply")]


def anchors(kind: str) -> Callable[[Path], list[str]]:
    """Return what writes a checkpoint of an anchor method."""

    def write(run: Path) -> list[str]:
        import gsgen.reference_plugins.synthetic as made

        if kind == "scaffold":
            made.write_scaffold(run, made.AnchorOptions(anchors=3000))
        elif kind == "octree":
            options = made.AnchorOptions(anchors=3000, iteration=40_000)
            made.write_octree(run, options, levels=5, distance=48)
        else:
            options = made.AnchorOptions(anchors=3000, iteration=40_000)
            made.write_duplex(run, options)
            return ["--checkpoint", str(run), "--blend", "wsr"]
        return ["--checkpoint", str(run)]

    return write


def hexplane(run: Path) -> list[str]:
    """Write a checkpoint of 4DGaussians."""
    from gsgen.reference_plugins.synthetic import HexPlaneOptions, write_hexplane

    grid = {"resolution": (4, 4, 4, 12), "multires": (1,)}
    write_hexplane(run, HexPlaneOptions(count=8000, sway=1.8, **grid))
    return ["--checkpoint", str(run)]


def deformable(run: Path) -> list[str]:
    """Write a checkpoint of Deformable-3D-Gaussians."""
    from gsgen.reference_plugins.synthetic import write_deformable

    write_deformable(run, count=8000, sway=1.0)
    return ["--checkpoint", str(run)]


def person(kind: str) -> Callable[[Path], list[str]]:
    """Return what writes a checkpoint of a person, and a motion to play."""

    def write(run: Path) -> list[str]:
        import gsgen.reference_plugins.synthetic as made

        chosen = made.PersonOptions(count=6000, vertices=3000, nets=kind == "r3")
        {"gauhuman": made.write_gauhuman, "lhm": made.write_lhm, "r3": made.write_r3}[kind](
            run, chosen
        )
        motion = made.write_motion(run / "walk.npz", frames=24)
        return ["--checkpoint", str(run), "--motion", str(motion)]

    return write


def denoiser(run: Path) -> list[str]:
    """Write a U-Net that takes off fine noise."""
    from gsgen.reference_plugins.synthetic import write_denoiser

    plain = {"down_block_types": ["DownBlock2D"] * 2, "up_block_types": ["UpBlock2D"] * 2}
    write_denoiser(run, plain | {"add_attention": False}, smoothing=True)
    step = ["--timestep", str(STEP), "--values", "unit"]
    return ["--checkpoint", str(run), *step, "--size", f"{TILE[1]}x{TILE[0]}"]


def stylise(run: Path) -> list[str]:
    """Write a network that draws."""
    from gsgen.reference_plugins.synthetic import write_stylise

    write_stylise(run, drawing=True)
    return ["--checkpoint", str(run), "--size", f"{TILE[1]}x{TILE[0]}"]


STEP = 60  # of the denoiser: how much noise there is


def with_noise(picture: np.ndarray) -> np.ndarray:
    """Add the noise that diffusion has at ``STEP`` (scaled linear β from 0.00085 to 0.012)."""
    beta = np.linspace(math.sqrt(0.00085), math.sqrt(0.012), 1000) ** 2
    kept = float(np.prod(1 - beta[: STEP + 1]))
    noise = np.random.default_rng(0).normal(size=picture.shape)
    signed = math.sqrt(kept) * (picture / 127.5 - 1) + math.sqrt(1 - kept) * noise
    return (np.clip(0.5 * signed + 0.5, 0, 1) * 255 + 0.5).astype(np.uint8)


ORBIT = "--camera orbit:20,30 --turn 300"
STAND = "--camera orbit:-50,6,2.6 --up +y"
FAMILIES = {
    "static": Family(static, ORBIT, "around a splat file"),
    "scaffold-gs": Family(
        anchors("scaffold"), ORBIT, "around it: colours follow the camera"
    ),
    "octree-gs": Family(
        anchors("octree"), "away", "from ever farther, zoomed in: levels go"
    ),
    "duplex-gs": Family(anchors("duplex"), ORBIT, "around it"),
    "hexplane-4dgs": Family(hexplane, "--camera orbit:20,35", "time 0 to 1"),
    "deformable-3dgs": Family(deformable, "--camera orbit:20,35", "time 0 to 1"),
    "gauhuman": Family(person("gauhuman"), STAND, "a motion"),
    "lhm": Family(person("lhm"), STAND, "a motion"),
    "r3-avatar": Family(person("r3"), STAND, "a motion"),
    "denoiser": Family(
        *(denoiser, ORBIT, "noise on a rendered image, and off it"),
        images=True,
        tried_on=with_noise,
    ),
    "stylise": Family(stylise, ORBIT, "a rendered image, and its drawing", images=True),
}


# %% The command line, in this process: torch is imported once for all that it exports.


def gsgen(log: Path, *words: str) -> tuple[int, str, str]:
    """Run the program as its console script does; return exit code, stdout and stderr."""
    from gsgen.cli import main

    out, trouble, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["gsgen", *words]
    try:
        with redirect_stdout(out), redirect_stderr(trouble):
            main()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0
    finally:
        sys.argv = before
    said = f"$ {shlex.join(['gsgen', *words])}\n{trouble.getvalue()}{out.getvalue()}\n"
    with log.open("a", encoding="utf-8") as file:
        file.write(said)
    return code, out.getvalue(), trouble.getvalue()


def required(log: Path, *words: str) -> None:
    """Run the program, and stop with its own words if it fails."""
    code, out, trouble = gsgen(log, *words)
    if code:
        raise RuntimeError(f"gsgen {shlex.join(words)} ended with {code}\n{out}{trouble}")


def make(name: str, folder: Path) -> DemoModel:
    """Export, judge, time and draw a family; ``commands.txt`` keeps what was typed and said."""
    family, log, model = FAMILIES[name], folder / "commands.txt", folder / f"{name}.onnx"
    run, report = folder / "run", folder / "report.json"
    # An earlier demo's checkpoint may have other files.
    shutil.rmtree(run, ignore_errors=True)
    run.mkdir(parents=True)
    log.write_text("", "utf-8")
    words = family.write(run)
    # Images go through a software driver for minutes, Gaussians for seconds.
    level = "behaviour" if family.images else "live"
    judged = ("--level", level, "--report", str(report))
    required(log, "export", name, *words, "-o", str(model), *judged)
    told = json.loads(report.read_text("utf-8"))["validation"]
    strip, trouble = draw(family, model, folder, log)
    return DemoModel(
        name=name,
        gaussians=told["subject"].get("capacity"),
        size=model.stat().st_size,
        verdict=told["verdict"],
        level=next(
            one["level"] for one in reversed(told["levels"]) if one["status"] == "ran"
        ),
        milliseconds=frame_time(model),
        strip=strip,
        trouble=trouble,
    )


def frame_time(model: Path) -> float:
    """Return milliseconds of a frame on the CPU, the median of five."""
    from gsgen.sdk.binding import FrameSession

    taken = []
    with FrameSession(model, provider="cpu") as session:
        for _ in range(5):
            began = time.perf_counter()
            session.run()
            taken.append(time.perf_counter() - began)
    return 1000 * sorted(taken)[2]


# %% Pictures.


def draw(family: Family, model: Path, folder: Path, log: Path) -> tuple[Path | None, str]:
    """Draw a strip of six pictures; or say why there can be none."""
    camera = family.camera.split()
    if camera == ["away"]:
        camera = ["--camera", str(away(folder / "cameras.json"))]
    scene, options = model, ["--frames", str(FRAMES), "--background", BACKGROUND, *camera]
    if family.images:  # the model makes no Gaussians: the knot is drawn, half as often
        static(folder)
        scene, options[1] = folder / "knot.ply", str(FRAMES // 2)
    try:
        pictures = frames(scene, options, folder / "frames", log)
        if family.tried_on is not None:
            before = [family.tried_on(one) for one in pictures]
            pictures = alternating(before, [processed(model, one) for one in before])
        elif family.images:
            options += ["--post", str(model)]
            pictures = alternating(pictures, frames(scene, options, folder / "after", log))
    except NoAdapterError as error:
        return None, str(error)
    strip = folder.parent / f"{model.stem}.png"
    Image.fromarray(np.concatenate(pictures, axis=1)).save(strip)
    return strip, ""


class NoAdapterError(RuntimeError):
    """There is neither a GPU nor a software driver to draw with."""


def frames(scene: Path, options: list[str], folder: Path, log: Path) -> list[np.ndarray]:
    """Draw a scene, and return the pictures."""
    shutil.rmtree(folder, ignore_errors=True)
    size = ["--width", str(TILE[0]), "--height", str(TILE[1])]
    words = ("render", str(scene), "-o", str(folder), *size, *options)
    code, _, trouble = gsgen(log, *words)
    if code and "adapter" in trouble:
        raise NoAdapterError(trouble.strip())
    if code:
        raise RuntimeError(f"gsgen {shlex.join(words)} ended with {code}\n{trouble}")
    names = sorted(folder.glob("frame_*.png"))
    return [np.asarray(Image.open(one).convert("RGB")) for one in names]


def alternating(first: list[np.ndarray], second: list[np.ndarray]) -> list[np.ndarray]:
    """Return one of the first, one of the second, and so on."""
    return [one for pair in zip(first, second, strict=True) for one in pair]


def away(path: Path) -> Path:
    """Write cameras that go away from the knot and zoom in as they go, so that it stays as large."""
    from gsgen.runtime.scene.camera import Camera

    made = []
    for distance in np.geomspace(6, 90, FRAMES):
        eye = distance * np.array([0.35, -0.5, -0.8])
        angle = 2 * math.degrees(math.atan(1.85 / distance))
        size = {"width": TILE[0], "height": TILE[1]}
        camera = Camera.look_at(eye.tolist(), [0, 0, 0], fov_y=angle, **size)
        near = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
        made.append({"view": camera.view.tolist(), **near, **size})
    path.write_text(json.dumps(made), "utf-8")
    return path


def processed(model: Path, picture: np.ndarray) -> np.ndarray:
    """Run a post-process model over a picture."""
    import onnxruntime

    from gsgen.runtime.playback.image_tiling import post_process

    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    image = np.moveaxis(picture, 2, 0)[None].astype(np.float32) / 255
    made = np.moveaxis(post_process(session, image)[0], 0, 2)
    return (np.clip(made, 0, 1) * 255 + 0.5).astype(np.uint8)


# %%
def make_all(folder: Path, names: list[str]) -> list[DemoModel]:
    """Make families, two at a time."""
    apart = get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=apart, initializer=share_cores) as pool:
        return list(pool.map(make, names, [folder / name for name in names]))


def share_cores() -> None:
    """Keep torch to one thread: two processes would wait for each other's."""
    os.environ["OMP_NUM_THREADS"] = "1"


def show(made: list[DemoModel], folder: Path, console: Console) -> None:
    """Print a table of what was made, and where it is."""
    console.print(table(made))
    for trouble in {one.trouble for one in made if one.trouble}:
        console.print(f"No pictures: {trouble}")
    console.print(
        f"Pictures: {folder}/NAME.png; what was typed: {folder}/NAME/commands.txt"
    )


def table(rows: list[DemoModel]) -> str:
    """Return the table of what was made: a frame is one on the CPU."""
    lines = [f"{'family':<17}{'Gaussians':>10}{'file':>11}{'a frame':>10}  verdict"]
    for one in rows:
        count = "–" if one.gaussians is None else f"{one.gaussians:,}"
        size, frame = f"{one.size / 1024:,.0f} KiB", f"{one.milliseconds:.1f} ms"
        shows = FAMILIES[one.name].shows if one.strip else "not drawn"
        verdict = f"{one.verdict} ({one.level}); picture: {shows}"
        lines.append(f"{one.name:<17}{count:>10}{size:>11}{frame:>10}  {verdict}")
    return "\n".join(lines)


def main() -> None:
    """Show the families that are named, or all."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo/families")
    names = sys.argv[2:] or list(FAMILIES)
    if unknown := [name for name in names if name not in FAMILIES]:
        sys.exit(f"demo: there is no family {unknown[0]}; known: {', '.join(FAMILIES)}")
    show(make_all(folder, names), folder, Console(highlight=False, soft_wrap=True))


if __name__ == "__main__":
    main()
