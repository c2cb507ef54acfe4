"""The command `gsgen export hexplane-4dgs`: exports a 4DGaussians checkpoint to ONNX."""

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
    from gsgen.reference_plugins.deformation.hexplane_4dgs import HexPlane4DGS

_Bake = Annotated[
    Literal["auto", "always", "never"],
    typer.Option(
        help="Store the products of the planes of space for each Gaussian (always), the planes "
        "themselves (never), or the smaller ones (auto)."
    ),
]
_PAPER_REFERENCE = Publication(
    paper="Wu et al. 2024",
    arxiv="2310.08528",
    code="https://github.com/hustvl/4DGaussians",
    licence="Apache-2.0; its files name Inria's licence, for research only",
)


@with_time_options
def build(
    checkpoint: Checkpoint,
    iteration: IterationOption = None,
    *,
    time: "Input",
    bake: _Bake = "auto",
) -> "HexPlane4DGS":
    """Read a checkpoint of 4DGaussians, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.deformation.hexplane_4dgs import HexPlane4DGS
    from gsgen.reference_plugins.deformation.hexplane_checkpoint import read_hexplanes
    from gsgen.reference_plugins.loading.provenance import producer_of

    read = read_hexplanes(checkpoint, iteration)
    report_checkpoint(read.describe(), read.run.cfg)
    if read.flags.mask == "empty_voxel":
        note("warning: empty_voxel was never compared with the original code")
    generator = HexPlane4DGS(read.canonical, read.nets, read.flags, time, bake=bake)
    generator.producer = producer_of(_PAPER_REFERENCE.code, read.run)
    return generator


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.deformation.synthetic_deformations import (
        HexPlaneOptions,
        write_hexplane,
    )

    options = HexPlaneOptions(count=8000, sway=1.0, resolution=(4, 4, 4, 12), multires=(1,))
    write_hexplane(folder, options)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="hexplane-4dgs",
    words="4dgs 4dgaussians 4d-gaussians 4d-gaussian-splatting 4d-gs 4d hexplane dynamic",
    title="4DGaussians",
    summary="Gaussians that a hexplane and a small network move.",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply and "
    "deformation.pth. Iterations of the coarse stage are passed over.",
    inputs=("time",),
    publication=_PAPER_REFERENCE,
    recognises=lambda run, iteration: (iteration / "deformation.pth").is_file(),
    demo=Demo(write=_write_demo, caption="time 0 to 1", view="still"),
    build=build,
)
