"""The command `gsgen export deformable-3dgs`: exports Deformable-3D-Gaussians to ONNX."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.reference_plugins.deformation.sc_gs_plugin import is_sc_gs
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
    from gsgen.reference_plugins.deformation.deformable_3dgs import Deformable3DGS

# Operations of a good graphics card in a sixtieth of a second, at a tenth of its peak.
_MAX_NETWORK_OPERATIONS = 60e9
_PAPER_REFERENCE = Publication(
    paper="Yang et al. 2024",
    arxiv="2309.13101",
    code="https://github.com/ingra14m/Deformable-3D-Gaussians",
    licence="MIT",
)


@with_time_options
def build(
    checkpoint: Checkpoint, iteration: IterationOption = None, *, time: "Input"
) -> "Deformable3DGS":
    """Read a checkpoint of Deformable-3D-Gaussians, and return a Gaussian generator."""
    from gsgen.reference_plugins.deformation.deformable_3dgs import Deformable3DGS
    from gsgen.reference_plugins.deformation.deformation_checkpoint import read_deformation
    from gsgen.reference_plugins.loading.provenance import producer_of

    read = read_deformation(checkpoint, iteration)
    report_checkpoint(read.describe(), read.run.cfg)
    if not read.run.cfg.file_exists:
        note(f"note: {read.run.cfg.path} is missing; the variant follows from the network's shapes")
    if read.operations > _MAX_NETWORK_OPERATIONS:
        note(f"warning: {read.operations / 1e9:.0f} GFLOP a frame is slow on most machines")
    generator = Deformable3DGS(read.canonical, read.net, time)
    generator.producer = producer_of(_PAPER_REFERENCE.code, read.run)
    return generator


def _recognises(run: Path, iteration: Path) -> bool:
    return (run / "deform").is_dir() and not is_sc_gs(run, iteration)


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.deformation.synthetic_deformations import write_deformable

    write_deformable(folder, count=8000, sway=1.0)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="deformable-3dgs",
    words="deformable deformable-gs deformable-gaussians d3dgs deform dynamic",
    title="Deformable-3D-Gaussians",
    summary="Gaussians that a network moves.",
    reads="Reads DIR/cfg_args, DIR/point_cloud/iteration_N/point_cloud.ply and "
    "DIR/deform/iteration_N/deform.pth.",
    inputs=("time",),
    publication=_PAPER_REFERENCE,
    recognises=_recognises,
    demo=Demo(write=_write_demo, caption="time 0 to 1", view="still"),
    build=build,
)
