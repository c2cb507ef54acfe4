"""The demo: a real scene becomes a generator, is judged, drawn, and four broken copies are caught.

Run it with ``make demo``, or ``python docs/examples/demo.py OUT``. It uses the captured garden
scene where ``GSGEN_SHARED`` (default ``../shared``) has it, and the sample garden elsewhere.
Then one model of each plugin is made, or of those that are named after OUT: see
``demo_families.py``.
"""

# %%
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import demo_families
import numpy as np
import onnx
from onnx import ModelProto, NodeProto, TensorProto, numpy_helper
from rich.console import Console
from scipy.spatial import KDTree

from gsgen.reference_plugins.samples import write_samples

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo")
CAPTURED = Path(os.environ.get("GSGEN_SHARED", "../shared")) / "data/garden/test_garden.npz"
SKY = "#b9d3ea"
LONELY = 0.06  # units of the captured scene, whose table is one unit wide
GSGEN = (sys.executable, "-m", "gsgen.cli")
console = Console(highlight=False, soft_wrap=True)


@contextmanager
def step(title: str) -> Iterator[None]:
    """Show what is being done and how long it took."""
    started = time.perf_counter()
    with console.status(title):
        yield
    console.print(f"[green]done[/] {title} ({time.perf_counter() - started:.1f} s)")


def gsgen(*words: str | Path) -> "subprocess.CompletedProcess[str]":
    """Run the command line as a user does."""
    utf8 = os.environ | {"PYTHONIOENCODING": "utf-8"}
    command = [*GSGEN, *map(str, words)]
    return subprocess.run(command, capture_output=True, env=utf8, encoding="utf-8")


# %% Four ways in which models are really broken.


def weight(model: ModelProto, name: str) -> TensorProto:
    """Return the weight behind an output."""
    return next(tensor for tensor in model.graph.initializer if tensor.name == f"{name}_weight")


def rewrite(model: ModelProto, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Replace the values of an output."""
    tensor = weight(model, name)
    changed = change(numpy_helper.to_array(tensor).copy())
    tensor.CopyFrom(numpy_helper.from_array(changed, tensor.name))


def logits(rows: np.ndarray) -> np.ndarray:
    """Forget the sigmoid."""
    p = np.clip(rows[:, 3], 1e-4, 1 - 1e-4)
    rows[:, 3] = np.log(p / (1 - p))
    return rows


def nan_row(rows: np.ndarray) -> np.ndarray:
    """Divide by zero once."""
    rows[len(rows) // 3, :3] = np.nan
    return rows


def channel_major(color: np.ndarray) -> np.ndarray:
    """Copy f_rest as the PLY has it: all red coefficients first."""
    return np.ascontiguousarray(color.reshape(len(color), -1, 3).transpose(0, 2, 1)).reshape(
        color.shape
    )


def int64_count(model: ModelProto) -> None:
    """Return the count as torch makes it."""
    model.graph.node.append(
        NodeProto(op_type="Cast", input=["count_32"], output=["num_points"], name="to_int64")
    )
    model.graph.node[-1].attribute.add(name="to", type=onnx.AttributeProto.INT, i=7)
    next(n for n in model.graph.node if n.output[0] == "num_points").output[0] = "count_32"
    for output in model.graph.output:
        if output.name == "num_points":
            output.type.tensor_type.elem_type = TensorProto.INT64


BREAKS: dict[str, tuple[str, str, Callable[[ModelProto], None]]] = {
    "logits": ("opacity is logits", "GV003", lambda m: rewrite(m, "gaussians", logits)),
    "sh_order": ("SH is channel-major", "GV014", lambda m: rewrite(m, "color_sh", channel_major)),
    "nan": ("one row is NaN", "GV001", lambda m: rewrite(m, "gaussians", nan_row)),
    "int64": ("the count is int64", "GO011", int64_count),
}


# %%
def main() -> None:
    """Export, validate, break, validate again."""
    OUT.mkdir(parents=True, exist_ok=True)
    source, opacity = prepare()
    model = OUT / "scene.onnx"
    with step(f"exporting {source.name} as a Gaussian Generator"):
        exported = gsgen("export", "static", source, "-o", model, "--sh-degree", "3", *opacity)
        expect(exported, 0)
    console.print(f"     {exported.stdout.strip()}")
    with step("validating it"):
        report = OUT / "report.json"
        expect(gsgen("validate", model, "--format", "json", "-o", report), 0)
        verdict = json.loads(report.read_text("utf-8"))
    holds = verdict["counts"]["rules"]["pass"]
    console.print(f"     verdict [bold green]{verdict['verdict']}[/]: {holds} rules hold")
    console.print("\nFour copies, each broken in a way that happens:\n")
    good = onnx.load(model)
    for name, (title, rule, damage) in BREAKS.items():
        show_broken(good, name, title, rule, damage)
    drawn = draw(model)
    plugins = sys.argv[2:] or list(demo_families.demo_plugins())
    with step(f"exporting, judging and drawing {len(plugins)} plugins, two at a time"):
        families = demo_families.make_all(OUT / "families", plugins)
    demo_families.show(families, OUT / "families", console)
    console.print(f"[bold]Made:[/] {model} and four broken copies; the verdict is {report}")
    for line in drawn:
        console.print(f"      {line}")
    console.print("[bold]Look at it:[/]")
    console.print(f"  .venv/bin/gsgen inspect {model}")
    console.print(f"  .venv/bin/gsgen validate {model} --target visionary")
    console.print(
        f"  .venv/bin/gsgen validate {OUT}/broken_nan.onnx; .venv/bin/gsgen explain GV001"
    )


# %% The scene.


def prepare() -> tuple[Path, tuple[str, ...]]:
    """Write the scene and its cameras into ``OUT``; return the scene's path and export options."""
    if not CAPTURED.is_file():
        with step("making a scene of our own, a garden of 70,000 splats"):
            write_samples(OUT, force=True)
        return OUT / "garden.ply", ()
    with np.load(CAPTURED) as scene:
        size = {"width": int(scene["width"]), "height": int(scene["height"]), "near": 0.01}
        poses = zip(scene["viewmats"].tolist(), scene["Ks"].tolist(), strict=True)
        cameras = [
            size | {"view": view, "fx": k[0][0], "fy": k[1][1], "cx": k[0][2], "cy": k[1][2]}
            for view, k in poses
        ]
        points, colors = scene["means3d"], scene["colors"]
    (OUT / "cameras.json").write_text(json.dumps(cameras), "utf-8")
    # Points become balls as large as their neighbours are far: a lonely one would hide the scene.
    distances, _ = KDTree(points).query(points, k=4)
    retained = distances[:, 1:].mean(axis=1) < LONELY
    np.savez(OUT / "captured.npz", points=points[retained], colors=colors[retained])
    return OUT / "captured.npz", ("--opacity", "0.8")


# %% What was judged is drawn.


def draw(model: Path) -> list[str]:
    """Draw the scene from its cameras, its depth, and a film around it; say where they are."""
    camera, sky = OUT / "cameras.json", ("--background", SKY)
    views, depth, film = OUT / "views", OUT / "depth", OUT / "orbit.mp4"
    around = ["--camera", "orbit:40,14,4.0", "--turn", "100", "--fov", "42"]
    if CAPTURED.is_file():
        around = ["--camera", "orbit:30,25,1.1", "--up", "+z"]
    large = ["--width", "960", "--height", "540", "--frames", "24", "--fps", "12"]
    drawings: dict[str, list[str | Path]] = {
        "drawing it from its cameras": ["-o", views, "--camera", camera, *sky],
        "drawing its depth": ["-o", depth, "--camera", camera, "--mode", "depth"],
        "drawing a film around it": ["-o", film, *around, *large, *sky],
    }
    for title, words in drawings.items():
        with step(title):
            completed = gsgen("render", model, *words)
        if completed.returncode and "adapter" in completed.stderr:
            return [f"No pictures: {completed.stderr.strip()}"]
        expect(completed, 0)
    last = sorted(views.glob("frame_*.png"))[-1].name
    return [
        f"{views}/frame_0000.png to {last}: its cameras; {depth}: how far away",
        f"{film}: a film around it",
    ]


# %% What was broken is named.


def show_broken(
    good: ModelProto, name: str, title: str, rule: str, damage: Callable[[ModelProto], None]
) -> None:
    """Break a copy, validate it, and show the finding that names the fault."""
    copy = ModelProto()
    copy.CopyFrom(good)
    damage(copy)
    path, report = OUT / f"broken_{name}.onnx", OUT / f"broken_{name}.json"
    path.write_bytes(copy.SerializeToString())
    # A heuristic rule only ever says "possible", and so never fails a run by itself.
    gsgen("validate", path, "--format", "json", "-o", report)
    findings = json.loads(report.read_text("utf-8"))["findings"]
    match = next((finding for finding in findings if finding["rule"] == rule), None)
    if match is None:
        sys.exit(f"demo: {path} should break {rule}, but the report has {findings}")
    console.print(f"[bold]{path.name}[/]: {title}")
    doubt = "" if match["certainty"] == "confirmed" else " (possible)"
    console.print(f"  [red]{match['rule']} {match['severity']}{doubt}[/] {match['slug']}")
    console.print(f"  {match['where']['subject']}: {match['message']}")
    console.print(f"  hint: {match['hint']}\n")


def expect(completed: "subprocess.CompletedProcess[str]", code: int) -> None:
    """Stop with the command's own words if it ended otherwise."""
    if completed.returncode != code:
        sys.exit(
            f"demo: {' '.join(completed.args)} ended with {completed.returncode}\n{completed.stdout}{completed.stderr}"
        )


if __name__ == "__main__":
    main()
