"""The command `gsgen tiles build`, which builds a tileset from scenes of any size."""

__all__ = ["build"]

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.cli.commands.tiles.quality_text import quality_text
from gsgen.cli.output import echo, echo_json
from gsgen.contract.errors import ConfigInvalid

if TYPE_CHECKING:
    from gsgen.tiles.build.build import BuildReport
    from gsgen.tiles.build.progress import Progress

_QUALITIES_BY_COUNT = {1: (0,), 2: (0, 2), 3: (0, 2, 4)}


_ScenesArgument = Annotated[
    list[Path],
    typer.Argument(
        help="Files of splats: PLY is read in pieces, other formats as a whole.", show_default=False
    ),
]
_Output = Annotated[
    Path, typer.Option("-o", "--output", help="The folder to write.", show_default=False)
]
_LeafSizeOption = Annotated[int, typer.Option(help="Most splats of a leaf.", min=1, max=1 << 20)]
_Engine = Annotated[
    str, typer.Option(help="serial, processes, dask (this machine) or dask=ADDRESS.")
]
_Workers = Annotated[
    int | None, typer.Option(help="Processes. [default: one a processor core]", min=1, max=1024)
]
_QualityCount = Annotated[
    int | None,
    typer.Option(
        help="How many qualities of SPZ to write, each a tileset-qN.json. [default: 3]",
        min=1,
        max=3,
        show_default=False,
    ),
]
_Codec = Annotated[
    Literal["spz", "khr", "sog"],
    typer.Option(
        help="SPZ version 2, plain float32 attributes, or a streamed SOG: lod-meta.json in place "
        "of a tileset."
    ),
]
_ImplicitOption = Annotated[
    bool | None,
    typer.Option(
        "--implicit/--explicit",
        help="Write an implicit octree, in subtrees. [default: from about 2,000 tiles on]",
        show_default=False,
    ),
]
_Transform = Annotated[
    Path | None,
    typer.Option(help="JSON: 16 numbers, scene → world. [default: upright, y down → z up]"),
]
_Origin = Annotated[
    str,
    typer.Option(
        metavar="auto|X,Y,Z",
        help="Point of the scenes that is 0,0,0 in the root tile; auto: 0,0,0, or a point that map "
        "coordinates need.",
    ),
]
_Longitude = Annotated[float | None, typer.Option(help="Longitude of the origin, in degrees.")]
_Latitude = Annotated[float | None, typer.Option(help="Latitude of the origin, in degrees.")]
_Height = Annotated[float | None, typer.Option(help="Height of the origin over WGS 84, in metres.")]
_Neural = Annotated[
    list[Path] | None,
    typer.Option(
        "--neural",
        help="A generator that becomes a neural tile: its first frame is the content; repeatable.",
        metavar="MODEL",
    ),
]
_FreshOption = Annotated[
    bool, typer.Option("--fresh", help="Start from the beginning; do not resume a stopped build.")
]
_JsonOption = Annotated[
    bool, typer.Option("--json", help="Print progress and result as lines of JSON.")
]


def build(
    scenes: _ScenesArgument,
    output: _Output,
    leaf: _LeafSizeOption = 8_192,
    engine: _Engine = "processes",
    workers: _Workers = None,
    quality: _QualityCount = None,
    codec: _Codec = "spz",
    *,
    implicit: _ImplicitOption = None,
    transform: _Transform = None,
    origin: _Origin = "auto",
    lon: _Longitude = None,
    lat: _Latitude = None,
    height: _Height = None,
    neural: _Neural = None,
    fresh: _FreshOption = False,
    as_json: _JsonOption = False,
) -> None:
    """Build a tileset of SCENES: a tree of tiles, coarse above and fine below.

    The same command resumes a build that was stopped.

    Exits 0 if the tileset is there, 2 for wrong options, 4 if a scene cannot be read, 130 if it
    was stopped.
    """
    from gsgen.cli.commands.tiles.progress_bar import BarProgress
    from gsgen.formats.shared.origins import parse_origin
    from gsgen.tiles.build.build import build_tileset
    from gsgen.tiles.build.engines.opening import open_engine
    from gsgen.tiles.build.neural_tiles import open_generator
    from gsgen.tiles.build.parameters import BuildParameters
    from gsgen.tiles.build.progress import JsonProgress

    if implicit and neural:
        raise ConfigInvalid(
            "cannot be combined with --implicit",
            where="--neural",
            hint="An implicit tile cannot hold a generator.",
        )
    if codec != "spz":
        _refuse({"--quality": quality}, codec, "its files have one quality")
    if codec == "sog":
        _refuse(
            {
                "--implicit": implicit,
                "--transform": transform,
                "--lon": lon,
                "--lat": lat,
                "--height": height,
                "--neural": neural,
            },
            codec,
            "a streamed SOG is neither placed nor divided so",
        )
    parameters = BuildParameters(
        leaf=leaf,
        codec="spz" if codec == "sog" else codec,
        is_streamed_sog=codec == "sog",
        qualities=_QUALITIES_BY_COUNT[quality or 3] if codec == "spz" else (0,),
        implicit=False if codec == "sog" else implicit,
        transform=_tileset_transform(transform, lon, lat, height),
        turn_upright=transform is None and codec != "sog",
        origin=parse_origin(origin),
    )
    generators = [open_generator(path) for path in neural or ()]
    progress: Progress = JsonProgress(_print_line) if as_json else BarProgress()
    try:
        with open_engine(engine, workers) as engine_context, progress:
            report = build_tileset(
                scenes,
                output,
                parameters,
                engine=engine_context,
                progress=progress,
                generators=generators,
                fresh=fresh,
            )
    except KeyboardInterrupt:
        message = f"stopped; the same command goes on where it was ({output})"
        echo(f"gsgen: {message}", err=True)
        raise
    if as_json:
        from dataclasses import asdict

        echo_json({"event": "done", **asdict(report)}, indent=None)
    else:
        echo(_report_text(report))


def _refuse(options: Mapping[str, object], codec: str, reason: str) -> None:
    for name, value in options.items():
        if value is not None:
            raise ConfigInvalid(f"cannot be combined with --codec {codec}: {reason}", where=name)


def _print_line(line: str) -> None:
    echo(line)
    sys.stdout.flush()


def _tileset_transform(
    path: Path | None, lon: float | None, lat: float | None, height: float | None
) -> tuple[float, ...]:
    from gsgen.tiles.build.frame import globe_transform, read_transform, upright_transform

    angles = {"--lon": lon, "--lat": lat}
    missing_options = [name for name, value in angles.items() if value is None]
    if path is not None:
        if len(missing_options) < len(angles) or height is not None:
            raise ConfigInvalid(
                "cannot be combined with --lon, --lat or --height", where="--transform"
            )
        return read_transform(path)
    if lon is not None and lat is not None:
        return globe_transform(lon, lat, height or 0.0)
    if len(missing_options) < len(angles) or height is not None:
        problem = f"{' and '.join(missing_options)} missing"
        raise ConfigInvalid(
            problem, hint="Give both --lon and --lat to place the scene on the globe."
        )
    return upright_transform()


def _report_text(report: "BuildReport") -> str:
    size = f"{report.bytes / 1e6:,.1f} MB"
    if report.up_to_date:
        return f"{report.output}: up to date, {report.splats:,} splats, {size}"
    text = f"{report.output}: {report.splats:,} splats in {report.tiles:,} tiles, {size}"
    qualities = report.quality_bytes
    return f"{text}: {quality_text(qualities, report.splats)}" if qualities else text
