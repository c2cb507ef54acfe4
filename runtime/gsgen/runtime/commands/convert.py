"""`gsgen convert`: splats from one file format to another."""

__all__ = ["convert"]

import json
import warnings
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gsgen.contract.errors import ConfigInvalid, ExitCode, UnknownName
from gsgen.contract.process.atomic_files import refuse_itself

if TYPE_CHECKING:
    from gsgen.formats.codecs import Codec
    from gsgen.formats.conversion import Conversion


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            help="PLY, compressed PLY, SPZ, SPLAT, KSPLAT, GLB, SOG or NPZ; told by its content.",
            show_default=False,
        ),
    ],
    target: Annotated[Path, typer.Argument(help="The file to write.", show_default=False)],
    format: Annotated[
        str | None,
        typer.Option(
            help="ply, compressed-ply, splat, spz or glb. [default: what TARGET ends in]"
        ),
    ] = None,
    sh_degree: Annotated[
        int | None,
        typer.Option(help="Drop harmonics above this degree.", min=0, max=4),
    ] = None,
    drop_invalid: Annotated[
        bool,
        typer.Option(
            "--drop-invalid",
            help="Leave out rows of a PLY that cannot be drawn (NaN, infinite), and say how many.",
        ),
    ] = False,
    spz_version: Annotated[
        int | None,
        typer.Option(
            help="Version of SPZ; 4 is in zstd, and few viewers read it. [default: 3]",
            min=1,
            max=4,
        ),
    ] = None,
    encoding: Annotated[
        Literal["ascii", "binary_little_endian", "binary_big_endian"] | None,
        typer.Option(help="Of PLY. [default: binary_little_endian]"),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Let TARGET be SOURCE, which is replaced.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print what was done and lost as JSON.")
    ] = False,
) -> None:
    """Write the splats of SOURCE to TARGET in another format, and say what was lost.

    Exits 0 if TARGET was written, 1 if it cannot be, 2 for wrong options, 4 if SOURCE cannot be
    read.
    """
    from gsgen.contract.commands.progress import clear, progress
    from gsgen.formats import FormatError, FormatWarning
    from gsgen.formats.conversion import convert as run

    codec = _codec(format, target)
    if not force:
        hint = "Name another file, or replace it with --force."
        refuse_itself(target, [source], hint)
    write = _writer(codec, spz_version, encoding)
    reading = True

    def step(words: str) -> None:
        nonlocal reading
        reading = words.startswith("reading")
        progress(words)

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FormatWarning)
        try:
            result = run(
                source,
                target,
                codec,
                sh_degree=sh_degree,
                drop_invalid=drop_invalid,
                write=write,
                step=step,
            )
        except FormatError as error:
            clear()
            typer.echo(f"gsgen: {error}", err=True)
            unreadable = reading and error.path == str(source)
            raise typer.Exit(
                ExitCode.UNREADABLE if unreadable else ExitCode.FAILURE
            ) from error
    clear()
    notes = list(dict.fromkeys(str(warning.message) for warning in caught))
    for note in notes:
        typer.echo(f"note: {note}", err=True)
    document = _as_dict(result) | {"notes": notes}
    typer.echo(json.dumps(document, indent=2) if as_json else _as_text(result))


def _codec(name: str | None, target: Path) -> "Codec":
    """Return the format that is asked for, or the one that the target's name ends in."""
    from gsgen.formats.codecs import CODECS, codec_named, codec_of_suffix

    writable = [codec.name for codec in CODECS if codec.write]
    if name is not None:
        if name not in writable:
            raise UnknownName.among("format", name, writable, where="--format")
        return codec_named(name)
    codec = codec_of_suffix(target)
    if codec is None or codec.write is None:
        problem = f"{codec.title} is only read" if codec else "ends in no known suffix"
        suffixes = [known.suffixes[0] for known in CODECS if known.write]
        raise ConfigInvalid(
            problem,
            where=str(target),
            hint=f"Let it end in {', '.join(suffixes)}, or give --format.",
        )
    return codec


def _writer(
    codec: "Codec", spz_version: int | None, encoding: str | None
) -> "Callable[..., None] | None":
    """Return what writes with the options of the format, or None where none is given."""
    writers: dict[str, tuple[str, dict[str, Any]]] = {}
    if spz_version is not None:
        writers["--spz-version"] = "spz", {"version": spz_version}
    if encoding is not None:
        writers["--encoding"] = "ply", {"format": encoding}
    for option, (format, _) in writers.items():
        if codec.name != format:
            raise ConfigInvalid(
                f"is for {format}, and {codec.name} is written",
                where=option,
                hint="Leave it out.",
            )
    assert codec.write is not None
    options = {key: value for _, words in writers.values() for key, value in words.items()}
    return partial(codec.write, **options) if options else None


def _as_dict(result: "Conversion") -> dict[str, Any]:
    document = asdict(result)
    document["degree"] = result.degree and list(result.degree)
    return document


def _as_text(result: "Conversion") -> str:
    before, after = (size / (1 << 20) for size in result.sizes)
    kind = "points" if result.degree is None else "splats"
    degree = f" of SH degree {result.degree[1]}" if result.degree else ""
    times = f", {before / after:.1f} times smaller" if before > 1.05 * after > 0 else ""
    lines = [
        f"{result.target}: {result.count:,} {kind}{degree}, {result.format}, "
        f"{before:.2f} MiB → {after:.2f} MiB{times}"
    ]
    lines += [f"lost: {loss}" for loss in result.lost]
    off = [difference for difference in result.differences if difference.largest]
    if off:
        lines.append(f"{'off by':<12}{'at most':>12}{'typically':>12}")
    lines += [
        f"  {difference.name:<10}{difference.largest:>12.3g}{difference.typical:>12.3g} {difference.unit}".rstrip()
        for difference in off
    ]
    if result.degree and not off and not result.lost:
        lines.append("nothing was lost")
    return "\n".join(lines)
