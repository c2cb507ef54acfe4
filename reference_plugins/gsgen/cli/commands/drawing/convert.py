"""`gsgen convert`: converts splats from one file format to another."""

__all__ = ["convert"]

import warnings
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.cli.commands.drawing.convert_edits import (
    Decimate,
    DropFloaters,
    Histograms,
    Morton,
    RotateOption,
    Scale,
    ShowStatistics,
    Sphere,
    TranslateOption,
    WhereOption,
    WithinBoxOption,
    edits_in_order,
)
from gsgen.cli.commands.drawing.options import Origin, PrintJsonOption
from gsgen.cli.output import echo, echo_error, echo_json
from gsgen.cli.output_hints import require_own_output
from gsgen.contract._safe_text import for_shell
from gsgen.contract.errors import ConfigInvalid, ExitCode, GsgenError, InputUnreadable
from gsgen.contract.file_kinds.names import SPLAT_FORMATS
from gsgen.contract.process.atomic_files import refuse_itself
from gsgen.formats.codecs import Codec, Content, codec_named, writable_formats
from gsgen.formats.editing.statistics import Statistics, statistics_text
from gsgen.formats.shared.files import FilePath
from gsgen.formats.tileset_paths import names_tileset

if TYPE_CHECKING:
    from gsgen.formats import FormatError
    from gsgen.formats.conversion import Conversion
    from gsgen.formats.shared.origins import Origin as Point

Sources = Annotated[
    list[str],
    typer.Argument(
        metavar="SOURCE…",
        help=f"{SPLAT_FORMATS}; recognised by its content. Several are merged. An address "
        "(https, hf, s3, …) is downloaded.",
        show_default=False,
    ),
]
Target = Annotated[Path, typer.Argument(help="The file to write.", show_default=False)]
Format = Annotated[
    str | None, typer.Option(help=f"{writable_formats()}. [default: by TARGET's suffix]")
]
DegreeOption = Annotated[
    int | None, typer.Option(help="Drop harmonics above this degree.", min=0, max=4)
]
DropInvalid = Annotated[
    bool,
    typer.Option(
        "--drop-invalid",
        help="Drop rows of a PLY that cannot be drawn (NaN, infinite), and print their number.",
    ),
]
SpzVersion = Annotated[
    int | None,
    typer.Option(
        help="Version of SPZ; few viewers read 4, which uses zstd. [default: 3]", min=1, max=4
    ),
]
Encoding = Annotated[
    Literal["ascii", "binary_little_endian", "binary_big_endian"] | None,
    typer.Option(help="Encoding of PLY. [default: binary_little_endian]"),
]
SpzAxes = Annotated[
    str | None,
    typer.Option(
        help="Axes of the SPZ files, such as RDF for splat-transform, which does not declare them. "
        "[default: RUB, or as declared]"
    ),
]
OutputOption = Annotated[
    Path | None, typer.Option("-o", "--output", help="TARGET, after any number of SOURCE.")
]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Allow TARGET to be SOURCE, which is replaced.")
]


def convert(
    context: typer.Context,
    sources: Sources,
    target: Target,
    *,
    format: Format = None,
    sh_degree: DegreeOption = None,
    drop_invalid: DropInvalid = False,
    origin: Origin = "auto",
    translate: TranslateOption = None,
    rotate: RotateOption = None,
    scale: Scale = None,
    box: WithinBoxOption = None,
    sphere: Sphere = None,
    where: WhereOption = None,
    drop_floaters: DropFloaters = None,
    decimate: Decimate = None,
    morton: Morton = False,
    statistics: ShowStatistics = False,
    histograms: Histograms = None,
    spz_version: SpzVersion = None,
    spz_axes: SpzAxes = None,
    encoding: Encoding = None,
    force: ForceOption = False,
    as_json: PrintJsonOption = False,
    output: OutputOption = None,
) -> None:
    """Write the splats of SOURCE to TARGET in another format, and print the losses.

    Exits 0 if TARGET was written, 1 if its format cannot store SOURCE, 2 for wrong options or if
    it cannot be written, 4 if SOURCE cannot be read.
    """
    from gsgen.formats.conversion import convert as convert_file
    from gsgen.formats.shared.origins import parse_origin
    from gsgen.runtime.baking.targets import writable_codec

    assert output is None or output == target  # the group's commands take it as TARGET
    point = parse_origin(origin)
    _refuse_scenes(sources)
    if format is None:
        require_own_output("convert", target, sources)
    codec = writable_codec(target, format, where=str(target))
    if not force:
        hint = "Name another file, or replace it with --force."
        refuse_itself(target, [Path(source) for source in sources], hint)
    for picture in histograms or ():
        refuse_itself(picture, [*map(Path, sources), target])
    values = {
        "translate": translate,
        "rotate": rotate,
        "scale": scale,
        "box": box,
        "sphere": sphere,
        "where": where,
        "drop_floaters": drop_floaters,
        "decimate": decimate,
        "histograms": histograms,
    }
    summaries: list[tuple[Statistics, ...]] = []
    merged_counts: list[tuple[int, int]] = []
    edits = edits_in_order(context, values, summaries, merged_counts)
    run = partial(
        convert_file,
        sources,
        target,
        codec,
        sh_degree=sh_degree,
        edits=edits,
        drop_invalid=drop_invalid,
        origin=point,
        read=_tileset_reader(sources, drop_invalid=drop_invalid, origin=point)
        or _reader(spz_axes, drop_invalid=drop_invalid, origin=point),
        read_back=_reader(spz_axes, drop_invalid=False) if codec.name == "spz" else None,
        write=_writer(codec, spz_version, spz_axes, encoding),
    )
    result, notes = _with_reported_warnings(run, sources)
    document = _conversion_as_dict(result)
    document["statistics"] = [[asdict(entry) for entry in summary] for summary in summaries]
    loss_lines = [
        f"--decimate merged {source_count:,} splats into {result_count:,}: detail is lost"
        for source_count, result_count in merged_counts
        if result_count < source_count
    ]
    document["notes"] = notes + loss_lines
    if as_json:
        echo_json(document)
        return
    for summary in summaries:
        echo(*statistics_text(summary).split("\n"), "")
    echo(*_conversion_lines(result, has_edits=bool(edits)), *loss_lines)


def _with_reported_warnings(
    run: "Callable[..., Conversion]", sources: list[str]
) -> "tuple[Conversion, list[str]]":
    """Run a splat conversion; return its result and warnings, or print the error and exit."""
    from gsgen.cli.progress import clear, progress
    from gsgen.formats import FileUnwritable, FormatError, FormatWarning

    is_reading = True

    def report_step(step: str) -> None:
        nonlocal is_reading
        is_reading = step.startswith("reading")
        progress(step)

    with warnings.catch_warnings(record=True) as caught_warnings:
        warnings.simplefilter("always", FormatWarning)
        try:
            result = run(step=report_step)
        except FileUnwritable:
            raise
        except FormatError as error:
            is_unreadable = is_reading and error.path is not None
            echo_error(_mesh_error(error) if is_unreadable else error)
            code = ExitCode.UNREADABLE if is_unreadable else ExitCode.FAILURE
            raise typer.Exit(code) from error
    clear()
    notes = list(dict.fromkeys(str(warning.message) for warning in caught_warnings))
    for note in notes:
        echo(f"note: {note}", err=True)
    return result, notes


def _mesh_error(error: "FormatError") -> GsgenError:
    """Return the error about a source that cannot be read; for a mesh, one that says so."""
    from gsgen.runtime.sources.mesh_files import is_mesh

    if error.path is None or not is_mesh(Path(error.path)):
        return error
    return _not_splats("mesh", error.path)


def _refuse_scenes(sources: list[str]) -> None:
    """Raise for a scene file, which any reader of tilesets would take for a damaged one."""
    from gsgen.runtime.sources.scene_file import is_scene_file

    for source in sources:
        if is_scene_file(Path(source)):
            raise _not_splats("scene", source)


def _not_splats(noun: str, source: str) -> GsgenError:
    return InputUnreadable(
        f"is a {noun}, expected splats",
        where=source,
        hint=f"`gsgen render {for_shell(source)} -o picture.png` draws it.",
    )


def _writer(
    codec: Codec, spz_version: int | None, spz_axes: str | None, encoding: str | None
) -> "Callable[..., None] | None":
    """Return a function that writes a splat file with these options; None if no option is given."""
    options: dict[str, object] = {}
    for option, name, keyword, value in (
        ("--spz-version", "spz", "version", spz_version),
        ("--encoding", "ply", "format", encoding),
    ):
        if value is None:
            continue
        if codec.name != name:
            raise ConfigInvalid(
                f"applies to {name} files, but the output format is {codec.name}",
                where=option,
                hint="Leave the option out.",
            )
        options[keyword] = value
    if spz_axes is not None and codec.name == "spz":
        options["axes"] = spz_axes
    assert codec.write is not None
    return partial(codec.write, **options) if options else None


def _tileset_reader(
    sources: list[str], *, drop_invalid: bool, origin: "Point | None"
) -> Callable[[FilePath], Content] | None:
    """Return a reader of splat files and tilesets; None if no source is a tileset."""
    if not any(names_tileset(source) for source in sources):
        return None
    from gsgen.cli.commands.drawing.opening import read_splats

    return partial(read_splats, drop_invalid=drop_invalid, origin=origin)


def _reader(
    spz_axes: str | None, *, drop_invalid: bool, origin: "Point | None" = None
) -> Callable[[FilePath], Content] | None:
    """Return a splat-file reader that assumes the given SPZ axes; None if no axes are given."""
    if spz_axes is None:
        return None
    from gsgen.formats.open import open_splats
    from gsgen.formats.shared.origins import with_origin
    from gsgen.formats.spz.spz import read_spz

    def read(path: FilePath) -> Content:
        if str(path).lower().endswith(codec_named("spz").suffixes):
            return with_origin(read_spz(path, axes=spz_axes), origin, path)
        return open_splats(path, drop_invalid=drop_invalid, origin=origin)

    return read


def _conversion_as_dict(result: "Conversion") -> dict[str, object]:
    document = asdict(result)
    document["degree"] = result.degree and list(result.degree)
    return document


def _conversion_lines(result: "Conversion", *, has_edits: bool) -> list[str]:
    source_mebibytes, result_mebibytes = (size / (1 << 20) for size in result.sizes)
    kind = "points" if result.degree is None else "splats"
    degree = f" of SH degree {result.degree[1]}" if result.degree else ""
    skipped_comparison = (
        [] if result.compared else ["not compared: the splats take more memory than that may"]
    )
    sizes = (
        f"{source_mebibytes:.2f} MiB → {result_mebibytes:.2f} MiB"
        if source_mebibytes
        else f"{result_mebibytes:.2f} MiB"
    )
    times = (
        f", {source_mebibytes / result_mebibytes:.1f} times smaller"
        if source_mebibytes > 1.05 * result_mebibytes > 0
        else ""
    )
    lines = [f"{result.target}: {result.count:,} {kind}{degree}, {result.format}, {sizes}{times}"]
    lines += [f"lost: {lost_item}" for lost_item in result.lost]
    changed_differences = [difference for difference in result.differences if difference.largest]
    if changed_differences:
        lines.append(f"{'off by':<12}{'at most':>12}{'typically':>12}")
    lines += [
        f"  {difference.name:<10}{difference.largest:>12.3g}{difference.typical:>12.3g} {difference.unit}".rstrip()
        for difference in changed_differences
    ]
    lines += skipped_comparison
    if result.degree and not changed_differences and not result.lost and result.compared:
        lines.append("nothing was lost by the format" if has_edits else "nothing was lost")
    return lines
