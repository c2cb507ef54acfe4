"""`gsgen bench`: measure the time and memory of a frame on each execution provider."""

__all__ = ["bench"]

from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.commands.drawing.options import ModelMemory, TrustOption, model_limits
from gsgen.cli.model_options import PrintJsonOption, Sizes, exit_at_error, sizes_of
from gsgen.cli.output import echo_json
from gsgen.contract._safe_text import for_json, printable
from gsgen.contract.errors import ExitCode

if TYPE_CHECKING:
    from gsgen.contract.process.limits import Limits
    from gsgen.sdk.binding.benchmark import BenchmarkResult

_MILLION_ROWS = 1e6


class ProviderName(StrEnum):
    """The execution providers that `gsgen bench` offers, as an enumeration for typer."""

    CPU = "cpu"
    WEBGPU = "webgpu"
    CUDA = "cuda"


def bench(
    models: Annotated[list[Path], typer.Argument(help="ONNX files.", show_default=False)],
    provider: Annotated[
        list[ProviderName] | None,
        typer.Option(help="Measure this provider only; repeatable. [default: all available ones]"),
    ] = None,
    frames: Annotated[int, typer.Option(help="Number of measured frames.", min=1)] = 100,
    size: Sizes = None,
    capture: Annotated[
        bool, typer.Option("--capture/--no-capture", help="Record a frame once and replay it.")
    ] = True,
    timeout: Annotated[
        float, typer.Option(help="Time limit in seconds for one model on one provider.", min=1)
    ] = 300,
    memory: ModelMemory = None,
    trust: TrustOption = False,
    as_json: PrintJsonOption = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Also write the JSON to this file.", allow_dash=True),
    ] = None,
) -> None:
    """Measure the time and memory of a frame of each MODEL on each execution provider.

    Prints the time of a frame (median and 95th percentile) from new inputs to outputs on the host,
    the time of the first frame including loading, the bytes of inputs and outputs, the share of
    time spent copying them, and millions of Gaussians per second.
    Each provider runs in its own process; a crash of one is reported as its result.
    Exits 0 if all were measured, 1 if one failed or crashed, or if a requested one is unavailable.
    """
    from gsgen.cli.output import write_text
    from gsgen.contract.process.atomic_files import refuse_model
    from gsgen.sdk.binding.providers.selection import installed_providers

    if output is not None:
        refuse_model(output, models)
    _require_models(models)
    sizes = sizes_of(size)
    providers = [str(name) for name in provider or installed_providers()]
    jobs = [(model, provider_name) for model in models for provider_name in providers]
    limits = model_limits(timeout, memory, trust=False)
    results = _measure_models(
        jobs, frames=frames, sizes=sizes, capture=capture, limits=limits, trusted=trust
    )
    document = _document(results)
    if output is not None:
        write_text(output, for_json(document) + "\n")
    if as_json:
        echo_json(document)
    else:
        _print_benchmark(results)
    failure_states = {"failed", "crashed"} | ({"unavailable"} if provider else set())
    has_failure = any(result.state in failure_states for result in results)
    raise typer.Exit(ExitCode.FAILURE if has_failure else ExitCode.SUCCESS)


def _require_models(models: list[Path]) -> None:
    """Exit with an error before measuring if one of the files is not a model."""
    from gsgen.contract.model.files_beside import require_loadable

    with exit_at_error():
        for model in models:
            require_loadable(model)


def _measure_models(
    jobs: list[tuple[Path, str]],
    *,
    frames: int,
    sizes: dict[str, int],
    capture: bool,
    limits: "Limits | None",
    trusted: bool,
) -> "list[BenchmarkResult]":
    from gsgen.cli.progress import clear, progress
    from gsgen.sdk.binding.benchmark import time_frames

    results = []
    try:
        for number, (model, provider) in enumerate(jobs, 1):
            progress(f"measuring {model.name} on {provider}, {number} of {len(jobs)}")
            results.append(
                time_frames(
                    model,
                    provider,
                    frames=frames,
                    sizes=sizes,
                    capture=capture,
                    limits=limits,
                    trusted=trusted,
                )
            )
    finally:
        clear()
    return results


def _document(results: "list[BenchmarkResult]") -> dict[str, object]:
    tools = {name: version(name) for name in ("gsgen", "onnxruntime")}
    return {
        "tools": tools,
        "results": [
            {"model": result.model, "provider": result.provider, "state": result.state}
            | ({"why": result.reason} if result.reason else {})
            | dict(result.facts)
            for result in results
        ],
    }


def _print_benchmark(results: "list[BenchmarkResult]") -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("model", min_width=8, overflow="fold")
    table.add_column("provider", no_wrap=True)
    for name in ("p50 ms", "p95 ms", "first ms", "in", "out", "copies", "M/s"):
        table.add_column(name, justify="right", no_wrap=True)
    for result in results:
        table.add_row(Text(printable(Path(result.model).name)), result.provider, *_cells(result))
    console = Console(highlight=False)
    console.print(table)
    for result in results:
        for note in _benchmark_notes(result):
            line = f"{Path(result.model).name} on {result.provider}: {note}"
            console.print(printable(line), markup=False, soft_wrap=True)


def _cells(result: "BenchmarkResult") -> list[str]:
    if result.state != "measured":
        return [result.state, *("–" for _ in range(6))]
    facts = result.facts
    rate = facts["gaussians_per_second"]
    return [
        f"{1000 * facts['p50_seconds']:.3f}",
        f"{1000 * facts['p95_seconds']:.3f}",
        f"{1000 * facts['first_frame_seconds']:.0f}",
        _decimal_size(facts["bytes_in"]),
        _decimal_size(facts["bytes_out"]),
        f"{100 * facts['copy_share']:.0f} %",
        "–" if rate is None else f"{rate / _MILLION_ROWS:.3g}",
    ]


def _decimal_size(count: int) -> str:
    size, units = float(count), ["B", "kB", "MB", "GB", "TB"]
    while size >= 1000 and len(units) > 1:
        size, units = size / 1000, units[1:]
    return f"{size:.3g} {units[0]}"


def _benchmark_notes(result: "BenchmarkResult") -> list[str]:
    """Return remarks about a benchmark result: device, graph capture, nodes that ran on the CPU."""
    if result.state != "measured":
        return [result.reason]
    facts, notes = result.facts, []
    if result.provider != "cpu":
        capture = "captured and replayed" if facts["captured"] else "not captured"
        notes.append(
            f"{facts['device']}, {capture}" + (f": {facts['cause']}" * bool(facts["cause"]))
        )
    if facts["nodes_on_cpu"]:
        operators = ", ".join(dict.fromkeys(facts["nodes_on_cpu"]))
        notes.append(
            f"{len(facts['nodes_on_cpu'])} of {facts['nodes']} nodes on the CPU ({operators})"
        )
    return notes
