"""Reports of simulations: a table, JSON, and a plot of loaded tiles and received bytes."""

__all__ = ["format_table", "metrics_document", "write_plot"]

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.units import MEBIBYTE
from gsgen.formats.shared.files import replace_file
from gsgen.tiles.format.json_values import JsonDict
from gsgen.tiles.simulate.client import Simulation
from gsgen.tiles.streaming.metrics import StreamingMetrics


def metrics_document(simulation: Simulation) -> JsonDict:
    """Return the metrics of a simulation as JSON; the time of an event that never came is null."""
    metrics = asdict(simulation.metrics)
    if math.isnan(metrics["first_good_s"]):
        metrics["first_good_s"] = None
    if simulation.prediction:
        errors = asdict(simulation.prediction).items()
        metrics["prediction"] = {
            name: None if math.isnan(value) else value for name, value in errors
        }
    if simulation.ssim:
        metrics["ssim"] = [{"t": seconds, "ssim": x} for seconds, x in simulation.ssim.items()]
    return {"policy": simulation.policy, **metrics}


def format_table(simulations: Sequence[Simulation]) -> str:
    """Return the streaming metrics as a text table, with one column per prefetch policy."""
    rows: list[tuple[str, Callable[[StreamingMetrics], str]]] = [
        ("hit rate", lambda m: f"{m.hit_rate:.1%}"),
        ("waste", lambda m: f"{m.waste:.1%}"),
        ("first good view", lambda m: f"{m.first_good_s:.2f} s"),
        ("good frames", lambda m: f"{m.share_good:.1%}"),
        ("delay, mean", lambda m: f"{m.mean_delay_s:.3f} s"),
        ("delay, 95 %", lambda m: f"{m.p95_delay_s:.3f} s"),
        ("frames with holes", lambda m: f"{m.hole_frames:,}"),
        ("entries", lambda m: f"{m.entries:,}"),
        ("received", lambda m: f"{m.bytes / MEBIBYTE:.2f} MiB"),
        ("requests", lambda m: f"{m.requests:,}"),
    ]
    lines = [f"{'':18}" + "".join(f"{s.policy:>14}" for s in simulations)]
    for name, text in rows:
        values = "".join(f"{text(s.metrics).replace('nan s', 'never'):>14}" for s in simulations)
        lines.append(f"{name:18}{values}")
    for seconds in sorted({seconds for s in simulations for seconds in s.ssim}):
        values = "".join(f"{s.ssim[seconds]:>14.4f}" for s in simulations)
        lines.append(f"{f'SSIM at {seconds:g} s':18}{values}")
    return "\n".join(lines)


def write_plot(simulations: Sequence[Simulation], path: Path) -> None:
    """Plot the share of needed tiles that are loaded, and the received bytes, over time.

    Args:
        simulations: A line each.
        path: A picture; its suffix names the format.

    Raises:
        ConfigInvalid: Matplotlib is not installed, or does not know the format.
        FileUnwritable: The picture could not be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigInvalid(
            "Matplotlib is not installed", where=str(path), hint="pip install 'gsgen[plots]'"
        ) from error
    plot_figure = Figure(figsize=(8, 5), layout="constrained")
    canvas = FigureCanvasAgg(plot_figure)
    kind = path.suffix.lower().lstrip(".")
    known = canvas.get_supported_filetypes()
    if kind not in known:
        raise ConfigInvalid(
            f"is {path.suffix or 'without a suffix'}, expected one of {', '.join(sorted(known))}",
            where=f"--plot {path}",
        )
    upper_axes, lower_axes = plot_figure.subplots(2, sharex=True)
    for simulation in simulations:
        upper_axes.step(
            simulation.times, simulation.share_loaded, where="post", label=simulation.policy
        )
        received = [size / MEBIBYTE for size in simulation.received]
        lower_axes.step(simulation.times, received, where="post", label=simulation.policy)
    upper_axes.set(ylabel="wanted tiles loaded", ylim=(0, 1.02))
    lower_axes.set(ylabel="received, MiB", xlabel="time, s")
    upper_axes.legend()
    # Without dates and versions: equal simulations give equal files.
    metadata = {"Software": None} if kind == "png" else {}
    with replace_file(path) as file:
        plot_figure.savefig(file, format=kind, metadata=metadata)
