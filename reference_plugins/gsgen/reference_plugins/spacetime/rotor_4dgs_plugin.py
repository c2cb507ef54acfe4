"""The command `gsgen export rotor-4dgs`: exports a checkpoint of rotor 4DGS to ONNX."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.reference_plugins.loading.options import (
    Checkpoint,
    IterationOption,
    note,
    report_checkpoint,
    with_time_options,
)
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.contract.spec.manifest import Input
    from gsgen.reference_plugins.loading.training_run import TrainingRun
    from gsgen.reference_plugins.spacetime.rotor_4dgs import Rotor4DGS

_Config = Annotated[
    Path | None,
    typer.Option(
        help="The YAML that the training was started with: its time_duration is in no checkpoint.",
        show_default=False,
    ),
]
_TimeDuration = Annotated[
    tuple[float, float] | None,
    typer.Option(
        help="Times of the first and the last frame, in place of --config: 0 1 for D-NeRF, 0 10 "
        "for Neural 3D Video.",
        show_default=False,
    ),
]
_Color = Annotated[
    Literal["sh", "rgb"],
    typer.Option(
        help="Colours: sh for renderers, which evaluate them towards the moved centre; rgb as the "
        "method does, towards the stored centre (adds the input view)."
    ),
]
_PAPER_REFERENCE = Publication(
    paper="Yang et al. 2024",
    arxiv="2310.10642",
    code="https://github.com/fudan-zvg/4d-gaussian-splatting",
    licence="MIT; its rasteriser names Inria's licence, for research only",
)


@with_time_options
def build(
    checkpoint: Checkpoint,
    config: _Config = None,
    time_duration: _TimeDuration = None,
    iteration: IterationOption = None,
    *,
    time: "Input",
    color: _Color = "sh",
) -> "Rotor4DGS":
    """Read a checkpoint of rotor 4DGS, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.loading.provenance import producer_of
    from gsgen.reference_plugins.spacetime.rotor_4dgs import Rotor4DGS
    from gsgen.reference_plugins.spacetime.rotor_checkpoint import read_rotor

    read = read_rotor(checkpoint, iteration)
    report_checkpoint(read.describe(), read.run.cfg)
    duration = _time_duration(read.run, config, time_duration)
    if read.has_environment:
        note("warning: the learnt background (env_map) is not of Gaussians, and is left out")
    prefilter = read.run.cfg.number("prefilter_var", -1.0)
    generator = Rotor4DGS(read.splats, duration, time, prefilter=prefilter, color=color)
    generator.producer = producer_of(_PAPER_REFERENCE.code, read.run, [read.path])
    return generator


def _time_duration(
    run: "TrainingRun", config: Path | None, time_duration: tuple[float, float] | None
) -> tuple[float, float]:
    """Return the times of the first and last frame, from --time-duration or from --config."""
    from gsgen.contract.errors import ConfigInvalid
    from gsgen.reference_plugins.loading.errors import NotInCheckpoint
    from gsgen.reference_plugins.spacetime.rotor_checkpoint import read_time_duration

    if config is not None and time_duration is not None:
        hint = "Give one of them."
        raise ConfigInvalid("cannot be combined with --config", where="--time-duration", hint=hint)
    if config is None and time_duration is None:
        message = "no file of the run has the times of its first and last frame"
        hint = "Give --config FILE, the training's YAML, or --time-duration 0 1."
        raise NotInCheckpoint(message, where=str(run.folder), hint=hint)
    if config is not None:
        time_duration = read_time_duration(config, max(1, run.cfg.integer("frame_ratio", 1)))
    assert time_duration is not None
    first, last = time_duration
    if not first < last:
        source = "--time-duration" if config is None else str(config)
        raise ConfigInvalid(
            f"the time goes from {first:g} to {last:g}, expected an end after the beginning",
            where=source,
        )
    return time_duration


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.spacetime.synthetic_rotor import write_rotor

    write_rotor(folder, count=12_000)
    return ["--checkpoint", str(folder), "--config", str(folder / "config.yaml")]


PLUGIN = Plugin(
    name="rotor-4dgs",
    words="4dgs 4dgaussians 4d-gaussians 4d-gaussian-splatting 4d-gs "
    "4d rotor native-4dgs realtime-4dgs dynamic",
    title="rotor 4DGS",
    summary="Gaussians in space and time, of which each moment is a slice.",
    reads="Reads DIR/chkpntN.pth and DIR/cfg_args, and the YAML of the training that --config "
    "names, for the times of the first and last frame.",
    inputs=("time", "view"),
    publication=_PAPER_REFERENCE,
    demo=Demo(write=_write_demo, caption="time 0 to 1", view="still"),
    build=build,
)
