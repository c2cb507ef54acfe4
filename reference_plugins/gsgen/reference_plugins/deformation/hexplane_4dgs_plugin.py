"""`gsgen export hexplane-4dgs`: a checkpoint of 4DGaussians as a generator."""

__all__ = ["PLUGIN"]

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.reference_plugins.loading.options import (
    Checkpoint,
    Fps,
    Frames,
    Iteration,
    Loop,
    note,
    tell,
)
from gsgen.sdk.plugins.plugin import Plugin

if TYPE_CHECKING:
    from gsgen.reference_plugins.deformation.hexplane_4dgs import HexPlane4DGS

_Bake = Annotated[
    Literal["auto", "always", "never"],
    typer.Option(
        help="Store the products of the planes of space for each Gaussian (always), the planes "
        "themselves (never), or what is smaller (auto)."
    ),
]
_SOURCE = "https://github.com/hustvl/4DGaussians"


def build(
    checkpoint: Checkpoint,
    iteration: Iteration = None,
    frames: Frames = None,
    fps: Fps = None,
    loop: Loop = False,
    bake: _Bake = "auto",
) -> "HexPlane4DGS":
    """Read a checkpoint, say what is in it, and return its generator."""
    from gsgen.reference_plugins.deformation.hexplane_4dgs import HexPlane4DGS
    from gsgen.reference_plugins.deformation.hexplane_checkpoint import read_hexplanes
    from gsgen.reference_plugins.loading.provenance import producer_of
    from gsgen.sdk import inputs

    read = read_hexplanes(checkpoint, iteration)
    tell(read.describe(), read.cfg)
    if read.flags.mask == "empty_voxel":
        note("warning: empty_voxel is honoured, but was never compared with the original")
    time = inputs.time(frames=frames, fps=fps, loop=loop or None)
    made = HexPlane4DGS(read.canonical, read.nets, read.flags, time, bake=bake)
    made.producer = producer_of(_SOURCE, read.folder, read.iteration)
    return made


PLUGIN = Plugin(
    name="hexplane-4dgs",
    summary="Gaussians that a hexplane and a small network move (4DGaussians).",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply and "
    "deformation.pth. Iterations of the coarse stage are passed over.",
    inputs=("time",),
    build=build,
)
