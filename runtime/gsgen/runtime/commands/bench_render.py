"""`gsgen bench-render`: what drawing a scene costs, stage by stage."""

__all__ = ["bench_render"]

import json
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gsgen.runtime.commands.options import (
    Compact,
    Height,
    Provider,
    RasteriserName,
    Scenes,
    Sizes,
    Width,
)

if TYPE_CHECKING:
    from gsgen.runtime.playback.frame_cost import FrameCost, Span

_CIRCLE = 360.0  # so that models that look at the camera have something to compute
_MILLI = 1000
_MEGA = 1e6


def bench_render(
    scenes: Scenes,
    camera: Annotated[
        str | None,
        typer.Option(help="As for render. [default: a full turn around everything]"),
    ] = None,
    width: Width = None,
    height: Height = None,
    frames: Annotated[int, typer.Option(help="How many frames are measured.", min=1)] = 30,
    compact: Compact = False,
    rasteriser: RasteriserName = "auto",
    size: Sizes = None,
    provider: Provider = "cpu",
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write the JSON to this file, too."),
    ] = None,
) -> None:
    """Measure what a frame of SCENES costs: computing, drawing stage by stage, and memory.

    A film is played and not written: times go through their range while an orbit turns. Wall and CPU time
    are those from one frame to the next; on a software driver, drawing is part of the CPU time.
    Stages are told by the device's timestamps where it has some.
    Exits 0 if it was measured, 2 for wrong options, 4 if a scene cannot be read.
    """
    from gsgen.contract.commands.output import write_text
    from gsgen.contract.commands.progress import clear, progress
    from gsgen.contract.process.atomic_files import refuse_model
    from gsgen.runtime.commands.opening import opened, scene_files
    from gsgen.runtime.playback.frame_cost import measure
    from gsgen.runtime.playback.frame_sequence import FrameSequence
    from gsgen.runtime.playback.scene_camera import scene_view
    from gsgen.runtime.renderer.renderer import Renderer
    from gsgen.sdk.commands.sizes import sizes_of

    if output is not None:
        refuse_model(output, scenes)
    view = scene_view(list(scene_files(scenes).values()), camera, width, height)
    sizes = sizes_of(size, "--size")
    with opened(scenes, provider=provider, sizes=sizes) as (sources, _):
        renderer = Renderer(rasteriser=rasteriser, compact=compact)
        film = FrameSequence(sources, view, frames=frames, turn=_CIRCLE, renderer=renderer)
        cost = measure(film, progress)
    clear()
    document = _document(scenes, cost) | {"rasteriser": renderer.rasteriser}
    text = json.dumps(document, indent=2, ensure_ascii=False)
    if output is not None:
        write_text(output, text + "\n")
    if as_json:
        typer.echo(text)
    else:
        _show(cost)


def _document(scenes: list[Path], cost: "FrameCost") -> dict[str, Any]:
    tools = {name: version(name) for name in ("gsgen", "onnxruntime", "wgpu")}
    return {"tools": tools, "scenes": [str(path) for path in scenes]} | asdict(cost)


def _show(cost: "FrameCost") -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column("of a frame", no_wrap=True)
    for name in ("p50 ms", "p95 ms"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_row("wall", *_cells(cost.wall))
    table.add_row("CPU, all threads", *_cells(cost.cpu))
    table.add_row("encode and submit, CPU", *_cells(cost.submit))
    for name, span in cost.inference.items():
        table.add_row(f"inference, {Path(name).name}", *_cells(span))
    clock_name = "by the device" if cost.clock == "timestamps" else "CPU"
    for name, seconds in cost.stages.items():
        table.add_row(f"{name}, {clock_name}", f"{_MILLI * seconds:.3f}", "")
    console = Console(highlight=False)
    console.print(table)
    for line in _lines(cost):
        console.print(line, markup=False, soft_wrap=True)


def _cells(span: "Span") -> tuple[str, str]:
    return f"{_MILLI * span.p50:.3f}", f"{_MILLI * span.p95:.3f}"


def _lines(cost: "FrameCost") -> list[str]:
    """Say what was drawn, where, and how much memory that takes."""
    width, height = cost.size
    kind = " (a software driver)" if cost.software else ""
    bytes_per_row = cost.rows_bytes / max(1, cost.capacity)
    return [
        f"{cost.frames} frames of {width}×{height} on {cost.device}{kind}",
        f"{cost.gaussians:,} Gaussians, {cost.visible:,} visible, {cost.pairs:,} pairs of a "
        "Gaussian and a tile",
        f"memory of the device: {cost.rows_bytes / _MEGA:.1f} MB of Gaussians, {bytes_per_row:.0f} bytes "
        f"each; {cost.plan_bytes / _MEGA:.1f} MB for drawing",
    ]
