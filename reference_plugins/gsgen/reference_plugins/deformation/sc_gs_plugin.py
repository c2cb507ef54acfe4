"""The command `gsgen export sc-gs`: exports a checkpoint of SC-GS to ONNX."""

__all__ = ["PLUGIN", "is_sc_gs"]

from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.reference_plugins.loading.method_detection import point_columns
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
    from gsgen.reference_plugins.deformation.sc_gs import ScGs

_PAPER_REFERENCE = Publication(
    paper="Huang et al. 2024",
    arxiv="2312.14937",
    code="https://github.com/yihua7/SC-GS",
    licence="MIT; its files name Inria's licence, for research only",
)


@with_time_options
def build(checkpoint: Checkpoint, iteration: IterationOption = None, *, time: "Input") -> "ScGs":
    """Read a checkpoint of SC-GS, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.deformation.sc_gs import ScGs
    from gsgen.reference_plugins.deformation.sc_gs_checkpoint import read_sc_gs
    from gsgen.reference_plugins.loading.provenance import producer_of

    read = read_sc_gs(checkpoint, iteration)
    report_checkpoint(read.describe(), read.run.cfg)
    if read.run.cfg.flag("d_rot_as_rotmat"):
        note("warning: d_rot_as_rotmat=True is honoured as in training; render.py ignores it")
    generator = ScGs(read, time)
    generator.producer = producer_of(_PAPER_REFERENCE.code, read.run)
    return generator


def is_sc_gs(run: Path, iteration: Path) -> bool:
    """Return whether a training run with a folder ``deform`` is of SC-GS, not Deformable-3DGS."""
    if not (run / "deform").is_dir():
        return False
    cfg = run / "cfg_args"
    names_deform_type = cfg.is_file() and b"deform_type=" in cfg.read_bytes()
    return names_deform_type or "fea_0" in point_columns(iteration)


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.deformation.synthetic_deformations import write_sc_gs

    write_sc_gs(folder, count=8000, nodes=64, sway=0.8)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="sc-gs",
    words="scgs sparse-controlled-gs control-points",
    title="SC-GS",
    summary="Gaussians that sparse control nodes carry.",
    reads="Reads DIR/cfg_args, DIR/point_cloud/iteration_N/point_cloud.ply and "
    "DIR/deform/iteration_N/deform.pth.",
    inputs=("time",),
    publication=_PAPER_REFERENCE,
    recognises=is_sc_gs,
    demo=Demo(write=_write_demo, caption="time 0 to 1", view="still"),
    build=build,
)
