"""`gsgen export static`: a splat file or a point cloud as a generator."""

__all__ = ["PLUGIN", "static"]

import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import InputUnreadable
from gsgen.contract.process.atomic_files import refuse_itself
from gsgen.sdk.exporting.sh_degrees import ONE_DEGREE
from gsgen.sdk.plugins.export_options import OPSETS, ExportRequest
from gsgen.sdk.plugins.plugin import Plugin

if TYPE_CHECKING:
    from gsgen.contract.validation.report import Report
    from gsgen.contract.validation.settings import Settings
    from gsgen.formats import PackedRows, PointCloud, Splats


def static(
    file: Annotated[
        Path,
        typer.Argument(
            help="PLY, compressed PLY, SPZ, SPLAT, KSPLAT, GLB, SOG or npz file.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="The ONNX file to write.", show_default=False),
    ],
    dtype: Annotated[
        Literal["float32", "float16"] | None,
        typer.Option(
            help="Of the outputs.", show_default="float32, or that of packed rows"
        ),
    ] = None,
    opacity: Annotated[
        float, typer.Option(help="Of bare points.", min=0.001, max=1.0)
    ] = 0.1,
    appearance: Annotated[
        Literal["sh", "rgb"] | None,
        typer.Option(help="What packed rows with three channels hold.", show_default="rgb"),
    ] = None,
    sh_degree: Annotated[
        int | None,
        typer.Option(
            help="SortConfig SH to this degree or fill up to it; points become SH.",
            show_default="as in the file",
            min=0,
            max=3,
        ),
    ] = None,
    capacity: Annotated[
        int | None,
        typer.Option(help="Rows of the outputs.", show_default="as many as needed", min=1),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Name in the manifest.", show_default="the file's")
    ] = None,
    color_space: Annotated[
        Literal["srgb", "linear"] | None,
        typer.Option(help="Of the colours.", show_default="what the file says, or srgb"),
    ] = None,
    antialias: Annotated[
        Literal["classic", "mip"] | None,
        typer.Option(
            help="How the scene was trained.", show_default="what the file says, or classic"
        ),
    ] = None,
    opset: Annotated[
        int,
        typer.Option(
            help="ONNX operator set; every runtime has kernels for 18.",
            min=OPSETS[0],
            max=OPSETS[1],
        ),
    ] = 18,
    target: Annotated[
        str, typer.Option(help="Consumer to validate for: core, webgpu, visionary, gsgen.")
    ] = "core",
    level: Annotated[
        str,
        typer.Option(
            help="How far to validate: static, values, behaviour, live or render."
        ),
    ] = "behaviour",
    no_rewrite: Annotated[
        bool,
        typer.Option("--no-rewrite", help="Changes nothing: this graph needs no rewrites."),
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option(help="Write what was done and found to this file, as JSON."),
    ] = None,
) -> None:
    """Export FILE as a generator without inputs."""
    from gsgen.formats import PackedRows, Splats
    from gsgen.reference_plugins.static.static import from_content, write_scene

    refuse_itself(output, [file])
    settings = _settings(target, level)
    content = _read(file)
    typer.echo(f"{file}: {_describe(content)}", err=True)
    if isinstance(content, Splats) and sh_degree is None:
        sh_degree = ONE_DEGREE.get(target)
    scene = from_content(
        content, dtype=dtype, opacity=opacity, appearance=appearance, sh_degree=sh_degree
    )
    for note in scene.notes:
        typer.echo(f"note: {note}", err=True)
    passing_through = isinstance(content, PackedRows)
    reports: list[Report] = []
    request = ExportRequest(
        output,
        name=name,
        dtype="float16" if scene.rows.dtype == "float16" else "float32",
        capacity=capacity,
        opset=opset,
        target=target,
        level=level,
        rewrite=not no_rewrite,
        report=report,
    )

    def accept(draft: Path) -> None:
        reports.append(_judge(draft, settings))
        written = reports[0].verdict == "conforms" or passing_through
        if report is not None:
            _write_report(report, request, replace(reports[0], path=str(output)), written)
        if not written:
            typer.echo(f"gsgen: {output} was not written", err=True)
            raise typer.Exit(1)

    write_scene(
        scene,
        output,
        name=name,
        capacity=capacity,
        color_space=color_space or _color_space(content),
        antialias=antialias or _antialias(content),
        opset=opset,
        accept=accept,
    )
    size = output.stat().st_size / (1 << 20)
    verdict = (
        "conforms"
        if reports[0].verdict == "conforms"
        else "does NOT conform; the rows were passed through unchanged"
    )
    typer.echo(f"{output}: {scene.source}, {scene.rows.dtype}, {size:.1f} MiB; {verdict}")


def _read(file: Path) -> "Splats | PointCloud | PackedRows":
    from gsgen.formats import FormatError, FormatWarning, open_splats

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FormatWarning)
        try:
            content = open_splats(file, drop_invalid=True)
        except FormatError as error:
            raise InputUnreadable(str(error)) from error
    for warning in caught:
        typer.echo(f"note: {warning.message}", err=True)
    return content


def _color_space(
    content: "Splats | PointCloud | PackedRows",
) -> Literal["srgb", "linear"]:
    from gsgen.formats import Splats

    return content.color_space if isinstance(content, Splats) else "srgb"


def _antialias(content: "Splats | PointCloud | PackedRows") -> Literal["classic", "mip"]:
    from gsgen.formats import Splats

    filtered = isinstance(content, Splats) and content.antialiased
    return "mip" if filtered else "classic"


def _describe(content: "Splats | PointCloud | PackedRows") -> str:
    from gsgen.formats import PointCloud, Splats

    if isinstance(content, Splats):
        return f"{len(content):,} splats, SH degree {content.degree}"
    kind = "coloured points" if isinstance(content, PointCloud) else "packed rows"
    return f"{len(content):,} {kind}"


def _settings(target: str, level: str) -> "Settings":
    """Return how far and for whom to validate; a wrong word ends the command."""
    from gsgen.contract.spec.severity import Level
    from gsgen.contract.spec.targets import load_target
    from gsgen.contract.validation.settings import Settings

    return Settings(level=Level.parse(level, "--level"), target=load_target(target))


def _judge(draft: Path, settings: "Settings") -> "Report":
    """Validate what was written; show the findings if it does not conform."""
    from gsgen.contract.commands.output import show
    from gsgen.contract.reporters.text import render
    from gsgen.contract.validator import validate

    report = validate(draft, settings)
    if report.verdict != "conforms":
        show(render(report))
    return report


def _write_report(
    path: Path, request: ExportRequest, report: "Report", written: bool
) -> None:
    from gsgen.sdk.plugins.export_report import Outcome, write_report

    write_report(path, request, "static", Outcome(written, report))


PLUGIN = Plugin(
    name="static",
    summary="A splat file or a coloured point cloud, unchanging.",
    reads="Reads splats (PLY, compressed PLY, SPZ, SPLAT, KSPLAT, GLB or SOG; SH degree 0 to 4), a "
    "point cloud (PLY with red, green, blue; npz with points, xyz or means3d and colors), or an "
    "npz of packed rows (gaussians and appearance), which passes through unchanged.",
    inputs=(),
    command=static,
)
