"""The command `gsgen export ex4dgs`: exports a checkpoint of Ex4DGS to ONNX."""

__all__ = ["PLUGIN"]

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.reference_plugins.loading.options import (
    Checkpoint,
    IterationOption,
    report_checkpoint,
    with_time_options,
)
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.contract.spec.manifest import Input
    from gsgen.reference_plugins.spacetime.ex4dgs import Ex4DGS

_PAPER_REFERENCE = Publication(
    paper="Lee et al. 2024",
    arxiv="2410.15629",
    code="https://github.com/juno181/Ex4DGS",
    licence="CC BY-NC 4.0; its files name Inria's licence, for research only",
)


@with_time_options
def build(checkpoint: Checkpoint, iteration: IterationOption = None, *, time: "Input") -> "Ex4DGS":
    """Read a checkpoint of Ex4DGS, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.loading.provenance import producer_of
    from gsgen.reference_plugins.spacetime.ex4dgs import Ex4DGS
    from gsgen.reference_plugins.spacetime.ex4dgs_checkpoint import read_ex4dgs

    read = read_ex4dgs(checkpoint, iteration)
    report_checkpoint(read.describe(), read.run.cfg)
    generator = Ex4DGS(read, replace(time, frames=time.frames or read.times.frames))
    generator.producer = producer_of(_PAPER_REFERENCE.code, read.run)
    return generator


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.spacetime.synthetic_ex4dgs import write_ex4dgs

    write_ex4dgs(folder, count=12_000)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="ex4dgs",
    words="explicit-4dgs keyframes",
    title="Ex4DGS",
    summary="Gaussians that are interpolated between key frames.",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply and "
    "dynamic_point_cloud.ply; of DIR/chkpntN.pth, if it is there, the duration.",
    inputs=("time",),
    publication=_PAPER_REFERENCE,
    recognises=lambda run, iteration: (iteration / "dynamic_point_cloud.ply").is_file(),
    demo=Demo(write=_write_demo, caption="time 0 to 1", view="still"),
    build=build,
)
