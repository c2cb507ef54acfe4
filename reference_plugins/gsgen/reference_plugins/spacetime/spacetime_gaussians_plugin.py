"""The command `gsgen export spacetime-gaussians`: exports SpacetimeGaussians to ONNX."""

__all__ = ["PLUGIN"]

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.spec.manifest import Input
from gsgen.reference_plugins.loading.method_detection import point_columns
from gsgen.reference_plugins.loading.options import (
    Iteration,
    note,
    report_checkpoint,
    with_time_options,
)
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.spacetime.spacetime_gaussians import SpacetimeGaussians

_Checkpoint = Annotated[
    Path,
    typer.Option("--checkpoint", help="Folder that training wrote, or a PLY.", show_default=False),
]
_Decode = Annotated[
    Literal["per-splat"] | None,
    typer.Option(
        help="Decode the features of the full model for each Gaussian; the method does so for each "
        "pixel, so colours are approximate.",
        show_default="none, for the lite model",
    ),
]
_PUBLICATION = Publication(
    paper="Li et al. 2024",
    arxiv="2312.16812",
    code="https://github.com/oppo-us-research/SpacetimeGaussians",
    licence="MIT; its files name Inria's licence, for research only",
)


@with_time_options
def build(
    checkpoint: _Checkpoint, iteration: Iteration = None, *, time: Input, decode: _Decode = None
) -> "SpacetimeGaussians":
    """Read a checkpoint of SpacetimeGaussians, report its contents, and return its generator."""
    from gsgen.reference_plugins.loading.errors import NotInCheckpoint
    from gsgen.reference_plugins.loading.provenance import producer_of
    from gsgen.reference_plugins.spacetime.spacetime_checkpoint import read_spacetime
    from gsgen.reference_plugins.spacetime.spacetime_gaussians import SpacetimeGaussians

    read = read_spacetime(checkpoint, iteration)
    report_checkpoint(read.describe(), read.run.cfg)
    if read.decoder is None and decode is not None:
        message = "is a lite model, whose colours need no decoder"
        raise NotInCheckpoint(message, where=str(read.cloud), hint="Leave out --decode.")
    if read.decoder is not None and decode is None:
        message = "is a full model, whose features are blended and then decoded in each pixel"
        hint = "Give --decode per-splat, which decodes each Gaussian by itself: an approximation."
        raise NotInCheckpoint(message, where=str(read.cloud), hint=hint)
    if decode is not None:
        note("warning: colours are approximate where Gaussians blend: the method decodes pixels")
    duration = read.run.cfg.integer("duration", 0)
    time = replace(time, frames=time.frames or duration or None)
    generator = SpacetimeGaussians(read.splats, read.decoder, time)
    if generator.color_range is not None:
        low, high = generator.color_range
        note(f"note: colours from {low:g} to {high:g} are blended as they are, like the method's")
    generator.producer = producer_of(_PUBLICATION.code, read.run, read.files)
    return generator


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.spacetime.synthetic_spacetime import write_spacetime

    write_spacetime(folder, count=12_000)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="spacetime-gaussians",
    title="SpacetimeGaussians",
    summary="Gaussians that move along polynomials, each for a part of the time.",
    reads="Reads a PLY with motion, or DIR/cfg_args and DIR/point_cloud/iteration_N: "
    "point_cloud.ply, and point_cloud.pt of the full model.",
    inputs=("time", "view"),
    publication=_PUBLICATION,
    recognises=lambda run, iteration: "trbf_center" in point_columns(iteration),
    demo=Demo(write=_write_demo, caption="time 0 to 1", view="still"),
    build=build,
)
