"""`gsgen bench-render`: measures time and memory of drawing a scene, stage by stage."""

__all__ = ["bench_render"]

from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.commands.drawing import options
from gsgen.cli.output import echo, echo_json
from gsgen.contract._safe_text import for_json, printable

if TYPE_CHECKING:
    from gsgen.runtime.playback.frame_cost import FrameCost, Span

_MEGABYTE = 1e6


def bench_render(
    scenes: options.Scenes,
    camera: Annotated[
        str | None,
        typer.Option(help="Camera; see `gsgen render`. [default: a full turn around the scene]"),
    ] = None,
    width: options.Width = None,
    height: options.Height = None,
    frames: Annotated[int, typer.Option(help="Number of measured frames.", min=1)] = 30,
    compact: options.Compact = False,
    rasteriser: options.RasteriserName = "auto",
    size: options.ImageSizes = None,
    provider: options.Provider = "cpu",
    trust: options.TrustOption = False,
    timeout: options.ModelTimeout = None,
    memory: options.ModelMemory = None,
    as_json: options.PrintJsonOption = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Also write the JSON to this file.", allow_dash=True),
    ] = None,
) -> None:
    """Measure the time and the memory of a frame of SCENES, stage by stage.

    Frames are played without being written: times go through their range while an orbit turns.
    Wall and CPU time count from one frame to the next; on a software driver, CPU time includes
    drawing. Stages use the device's timestamps where it has them.
    Exits 0 if it was measured, 2 for wrong options, 4 if a scene cannot be read.
    """
    from gsgen.cli.commands.drawing.input_files import input_files, scene_inputs
    from gsgen.cli.commands.drawing.opening import open_scenes, read_scene_files
    from gsgen.cli.output import write_text
    from gsgen.cli.progress import clear, progress
    from gsgen.contract.process.atomic_files import refuse_model
    from gsgen.runtime.playback.frame_cost import measure
    from gsgen.runtime.playback.frame_sequence import FULL_TURN_DEGREES, FrameSequence
    from gsgen.runtime.playback.scene_camera import scene_viewpoint
    from gsgen.runtime.renderer.renderer import Renderer

    if output is not None:
        refuse_model(output, input_files(scenes, camera=camera))
    symbols, width, height = options.split_image_size(size, width, height, scenes)
    files = list(read_scene_files(scenes).values())
    if output is not None:
        refuse_model(output, scene_inputs(files))
    view = scene_viewpoint(files, camera, width, height)
    limits = options.model_limits(timeout, memory, trust=trust)
    opening = open_scenes(scenes, provider=provider, size=symbols, limits=limits, scene_posts=False)
    with opening as (sources, _):
        renderer = Renderer(rasteriser=rasteriser, compact=compact)
        # The orbit makes models that depend on the camera compute in every frame.
        sequence = FrameSequence(
            sources, view, frames=frames, turn=FULL_TURN_DEGREES, renderer=renderer
        )
        for note in sequence.notes:
            echo(f"note: {note}", err=True)
        frame_cost = measure(sequence, progress)
    clear()
    document = _document(scenes, frame_cost) | {"rasteriser": renderer.rasteriser}
    if output is not None:
        write_text(output, for_json(document) + "\n")
    if as_json:
        echo_json(document)
    else:
        _print_frame_cost(frame_cost)


def _document(scenes: list[Path], frame_cost: "FrameCost") -> dict[str, object]:
    tools = {name: version(name) for name in ("gsgen", "onnxruntime", "wgpu")}
    return {"tools": tools, "scenes": [str(path) for path in scenes]} | asdict(frame_cost)


def _print_frame_cost(frame_cost: "FrameCost") -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column("per frame", no_wrap=True)
    for name in ("p50 ms", "p95 ms"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_row("wall", *_cells(frame_cost.wall))
    table.add_row("CPU, all threads", *_cells(frame_cost.cpu))
    table.add_row("encode and submit, CPU", *_cells(frame_cost.submit))
    for name, phase_times in frame_cost.inference.items():
        table.add_row(Text(printable(f"inference, {Path(name).name}")), *_cells(phase_times))
    clock_name = "by the device" if frame_cost.clock == "timestamps" else "CPU"
    for name, seconds in frame_cost.stages.items():
        table.add_row(f"{name}, {clock_name}", _milliseconds(seconds), "")
    console = Console(highlight=False)
    console.print(table)
    for line in _summary_lines(frame_cost):
        console.print(printable(line), markup=False, soft_wrap=True)


def _cells(phase_times: "Span") -> tuple[str, str]:
    return _milliseconds(phase_times.p50), _milliseconds(phase_times.p95)


def _milliseconds(seconds: float) -> str:
    return f"{1000 * seconds:.3f}"


def _summary_lines(frame_cost: "FrameCost") -> list[str]:
    """Format the counts of drawn frames, the device and its memory as lines of text."""
    width, height = frame_cost.size
    kind = " (a software driver)" if frame_cost.software else ""
    bytes_per_row = frame_cost.rows_bytes / max(1, frame_cost.capacity)
    return [
        f"{frame_cost.frames} frames of {width}×{height} on {frame_cost.device}{kind}",
        f"{frame_cost.gaussians:,} Gaussians, {frame_cost.visible:,} visible, {frame_cost.pairs:,} pairs of a "
        "Gaussian and a tile",
        f"{frame_cost.frames_in_flight} frames in flight; the host waited {_milliseconds(frame_cost.waited)} ms "
        f"a frame; buffers grew {frame_cost.growths}×, frames drawn again: {frame_cost.redrawn}",
        f"memory of the device: {frame_cost.rows_bytes / _MEGABYTE:.1f} MB of Gaussians, {bytes_per_row:.0f} bytes "
        f"each; {frame_cost.plan_bytes / _MEGABYTE:.1f} MB for drawing",
    ]
