"""The command `gsgen export static`: exports a splat file or point cloud as an ONNX generator."""

__all__ = ["PLUGIN", "build"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.file_kinds.names import SPLAT_FORMATS
from gsgen.reference_plugins.loading.options import note
from gsgen.sdk.plugins.plugin import Demo, Plugin

if TYPE_CHECKING:
    from gsgen.formats import PackedRows, PointCloud, Splats
    from gsgen.reference_plugins.static.static import StaticScene


def build(
    file: Annotated[
        Path,
        typer.Argument(
            help=f"A file of splats, packed rows or points: {SPLAT_FORMATS}.", show_default=False
        ),
    ],
    opacity: Annotated[
        float, typer.Option(help="Opacity of bare points.", min=0.001, max=1.0)
    ] = 0.1,
    appearance: Annotated[
        Literal["sh", "rgb"] | None,
        typer.Option(help="Appearance of packed rows with three channels.", show_default="rgb"),
    ] = None,
    sh_degree: Annotated[
        int | None,
        typer.Option(
            help="Cut SH to this degree, or pad them to it; points become SH.",
            show_default="as in the file",
            min=0,
            max=3,
        ),
    ] = None,
    color_space: Annotated[
        Literal["srgb", "linear"] | None,
        typer.Option(help="Color space.", show_default="that of the file, or srgb"),
    ] = None,
    antialias: Annotated[
        Literal["classic", "mip"] | None,
        typer.Option(
            help="Antialiasing of the training.", show_default="that of the file, or classic"
        ),
    ] = None,
    origin: Annotated[
        str,
        typer.Option(
            metavar="auto|X,Y,Z",
            help="Point of the file that is 0,0,0 in the model, which the manifest declares; auto: "
            "0,0,0, or a point that map coordinates need.",
        ),
    ] = "auto",
) -> "StaticScene":
    """Read a splat file or a point cloud for its export as an ONNX generator without inputs."""
    from gsgen.reference_plugins.static.static import StaticScene

    content = _read(file, origin)
    note(f"{file}: {_describe_content(content)}")
    return StaticScene(
        content=content,
        opacity=opacity,
        appearance=appearance,
        sh_degree=sh_degree,
        color_space=color_space,
        antialias=antialias,
    )


def _read(file: Path, origin: str) -> "Splats | PointCloud | PackedRows":
    from gsgen.formats.shared.origins import parse_origin
    from gsgen.tiles.loading.leaves import open_splats

    return open_splats(file, drop_invalid=True, origin=parse_origin(origin))


def _describe_content(content: "Splats | PointCloud | PackedRows") -> str:
    from gsgen.formats import PointCloud, Splats

    if isinstance(content, Splats):
        return f"{len(content):,} splats, SH degree {content.degree}"
    kind = "coloured points" if isinstance(content, PointCloud) else "packed rows"
    return f"{len(content):,} {kind}"


def _write_demo(folder: Path) -> list[str]:
    from gsgen.formats import write_ply
    from gsgen.reference_plugins.writing.knot import torus_knot

    write_ply(folder / "knot.ply", torus_knot(20_000))
    return [str(folder / "knot.ply")]


PLUGIN = Plugin(
    name="static",
    words="3dgs mcmc 3dgs-mcmc gsplat-mcmc gof trellis pixelsplat mvsplat gaussian-splatting gaussian-splat 3d-gaussian-splatting gsplat splatfacto inria splat "
    "splats gs ply point-cloud pointcloud vanilla nerfstudio mip-splatting",
    summary="A splat file or a coloured point cloud, unchanging.",
    reads=f"Reads {SPLAT_FORMATS}: splats of SH degree 0 to 4, a point cloud (a PLY with red, "
    "green and blue, or an NPZ with points, xyz or means3d and colors), or an NPZ of packed rows "
    "(gaussians and appearance), which passes through unchanged.",
    inputs=(),
    demo=Demo(write=_write_demo, caption="around a splat file"),
    build=build,
)
