"""The command `gsgen export 2dgs`: exports a checkpoint of 2DGS to ONNX."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.reference_plugins.loading.method_detection import point_columns
from gsgen.reference_plugins.loading.options import (
    CloudFile,
    IterationOption,
    note,
    report_checkpoint,
)
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.static.static import StaticScene


def build(checkpoint: CloudFile, iteration: IterationOption = None) -> "StaticScene":
    """Read a checkpoint of 2DGS, report its contents, and return its scene."""
    from gsgen.reference_plugins.static.static import StaticScene
    from gsgen.reference_plugins.static.surfels import read_surfels

    read = read_surfels(checkpoint, iteration)
    report_checkpoint(read.describe(), read.run.cfg)
    note("note: renderers of 3D Gaussians draw the discs with an affine projection")
    return StaticScene(content=read.splats)


def _recognises(run: Path, iteration: Path) -> bool:
    columns = point_columns(iteration)
    return "scale_1" in columns and "scale_2" not in columns


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.static.synthetic_surfels import write_surfels

    write_surfels(folder, count=12_000)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="2dgs",
    words="2d-gaussian-splatting 2d-gs surfels surfel",
    title="2DGS",
    summary="Flat Gaussians on the surfaces of a scene, unchanging.",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N/point_cloud.ply, or a PLY with two "
    "scales.",
    inputs=(),
    publication=Publication(
        paper="Huang et al. 2024",
        arxiv="2403.17888",
        code="https://github.com/hbb1/2d-gaussian-splatting",
        licence="Inria's licence, for research only",
    ),
    recognises=_recognises,
    demo=Demo(write=_write_demo, caption="around a surface of discs", view="orbit"),
    build=build,
)
