"""`gsgen bench`: what a frame costs on each execution provider."""

__all__ = ["bench"]

import json
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.errors import ModelUnreadable

if TYPE_CHECKING:
    from gsgen.sdk.binding.benchmark import Timed

_UNREADABLE = 4
_MILLION = 1e6


class ProviderName(StrEnum):
    """What can be asked for; typer takes lists of an Enum alone."""

    CPU = "cpu"
    WEBGPU = "webgpu"
    CUDA = "cuda"


def bench(
    models: Annotated[list[Path], typer.Argument(help="ONNX files.", show_default=False)],
    provider: Annotated[
        list[ProviderName] | None,
        typer.Option(
            help="Measure this one only; repeatable. [default: all that are here]"
        ),
    ] = None,
    frames: Annotated[int, typer.Option(help="How many frames are measured.", min=1)] = 100,
    size: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SYMBOL=SIZE", help="Give an open dimension a size; repeatable."
        ),
    ] = None,
    capture: Annotated[
        bool,
        typer.Option("--capture/--no-capture", help="Record a frame once and replay it."),
    ] = True,
    timeout: Annotated[
        float, typer.Option(help="Seconds for one model on one provider.", min=1)
    ] = 300,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write the JSON to this file, too."),
    ] = None,
) -> None:
    """Measure what a frame of each MODEL costs, on each execution provider.

    Prints the time of a frame (median and 95th percentile) from new inputs to outputs on the host,
    of the first frame with everything before it, the bytes that go in and out, the share of time
    spent copying them, and millions of Gaussians a second.
    Each provider runs in a process of its own; one that crashes is reported as crashed.
    Exits 0 if all were measured, 1 if one failed or crashed, or is not here and was asked for.
    """
    from gsgen.contract.commands.output import write_text
    from gsgen.contract.process.atomic_files import refuse_model
    from gsgen.sdk.binding.providers.selection import installed
    from gsgen.sdk.commands.sizes import sizes_of

    if output is not None:
        refuse_model(output, models)
    _need_models(models)
    sizes = sizes_of(size, "--size")
    chosen = [str(one) for one in provider or installed()]
    jobs = [(model, one) for model in models for one in chosen]
    results = _measure(jobs, frames=frames, sizes=sizes, capture=capture, seconds=timeout)
    text = json.dumps(_document(results), indent=2, ensure_ascii=False)
    if output is not None:
        write_text(output, text + "\n")
    if as_json:
        typer.echo(text)
    else:
        _show(results)
    bad = {"failed", "crashed"} | ({"unavailable"} if provider else set())
    raise typer.Exit(int(any(one.state in bad for one in results)))


def _need_models(models: list[Path]) -> None:
    """Refuse what is no model before minutes are spent on the others."""
    from gsgen.contract.model.model_file import open_model

    try:
        for model in models:
            open_model(model)
    except ModelUnreadable as error:
        typer.echo(f"gsgen: {error}", err=True)
        raise typer.Exit(_UNREADABLE) from error


def _measure(
    jobs: list[tuple[Path, str]],
    *,
    frames: int,
    sizes: dict[str, int],
    capture: bool,
    seconds: float,
) -> "list[Timed]":
    from rich.console import Console
    from rich.progress import Progress

    from gsgen.sdk.binding.benchmark import time_frames

    results = []
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=len(jobs))
        for model, one in jobs:
            progress.update(task, description=f"{model.name} on {one}")
            results.append(
                time_frames(
                    model, one, frames=frames, sizes=sizes, capture=capture, seconds=seconds
                )
            )
            progress.advance(task)
    return results


def _document(results: "list[Timed]") -> dict[str, object]:
    tools = {name: version(name) for name in ("gsgen", "onnxruntime")}
    return {
        "tools": tools,
        "results": [
            {"model": one.model, "provider": one.provider, "state": one.state}
            | ({"why": one.why} if one.why else {})
            | dict(one.facts)
            for one in results
        ],
    }


def _show(results: "list[Timed]") -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("model", min_width=8, overflow="fold")
    table.add_column("provider", no_wrap=True)
    for name in (
        "p50 ms",
        "p95 ms",
        "first ms",
        "in",
        "out",
        "copies",
        "M/s",
    ):
        table.add_column(name, justify="right", no_wrap=True)
    for one in results:
        table.add_row(Path(one.model).name, one.provider, *_cells(one))
    console = Console(highlight=False)
    console.print(table)
    for one in results:
        for note in _notes(one):
            line = f"{Path(one.model).name} on {one.provider}: {note}"
            console.print(line, markup=False, soft_wrap=True)


def _cells(one: "Timed") -> list[str]:
    if one.state != "measured":
        return [one.state, *("–" for _ in range(6))]
    facts = one.facts
    rate = facts["gaussians_per_second"]
    return [
        f"{1000 * facts['p50_seconds']:.3f}",
        f"{1000 * facts['p95_seconds']:.3f}",
        f"{1000 * facts['first_frame_seconds']:.0f}",
        _bytes(facts["bytes_in"]),
        _bytes(facts["bytes_out"]),
        f"{100 * facts['copy_share']:.0f} %",
        "–" if rate is None else f"{rate / _MILLION:.3g}",
    ]


def _bytes(count: int) -> str:
    """Return a size in three digits and a unit."""
    size, units = float(count), ["B", "kB", "MB", "GB", "TB"]
    while size >= 1000 and len(units) > 1:
        size, units = size / 1000, units[1:]
    return f"{size:.3g} {units[0]}"


def _notes(one: "Timed") -> list[str]:
    """Say what the figures do not."""
    if one.state != "measured":
        return [one.why]
    facts, notes = one.facts, []
    if one.provider != "cpu":
        how = "captured and replayed" if facts["captured"] else "not captured"
        notes.append(
            f"{facts['device']}, {how}" + (f": {facts['cause']}" * bool(facts["cause"]))
        )
    if facts["nodes_on_cpu"]:
        named = ", ".join(dict.fromkeys(facts["nodes_on_cpu"]))
        notes.append(
            f"{len(facts['nodes_on_cpu'])} of {facts['nodes']} nodes on the CPU ({named})"
        )
    return notes
