"""`gsgen convert`: converts splats from one file format to another."""

__all__ = ["convert"]

import json
import warnings
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid, ExitCode
from gsgen.contract.process.atomic_files import refuse_itself
from gsgen.formats.codecs import CODECS, Codec, format_titles
from gsgen.runtime.commands.options import AsJson

if TYPE_CHECKING:
    from gsgen.formats.conversion import Conversion

_WRITABLE = [codec.name for codec in CODECS if codec.write]

Source = Annotated[
    Path, typer.Argument(help=f"{format_titles()}; recognised by its content.", show_default=False)
]
Target = Annotated[Path, typer.Argument(help="The file to write.", show_default=False)]
Format = Annotated[
    str | None,
    typer.Option(
        help=f"{', '.join(_WRITABLE[:-1])} or {_WRITABLE[-1]}. [default: by TARGET's suffix]"
    ),
]
Degree = Annotated[int | None, typer.Option(help="Drop harmonics above this degree.", min=0, max=4)]
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
Force = Annotated[
    bool, typer.Option("--force", help="Allow TARGET to be SOURCE, which is replaced.")
]


def convert(
    source: Source,
    target: Target,
    *,
    format: Format = None,
    sh_degree: Degree = None,
    drop_invalid: DropInvalid = False,
    spz_version: SpzVersion = None,
    encoding: Encoding = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Write the splats of SOURCE to TARGET in another format, and print the losses.

    Exits 0 if TARGET was written, 1 if it cannot be, 2 for wrong options, 4 if SOURCE cannot be
    read.
    """
    from gsgen.contract.commands.progress import clear, progress
    from gsgen.formats import FormatError, FormatWarning
    from gsgen.formats.conversion import convert as convert_file
    from gsgen.runtime.baking.targets import writable_codec

    codec = writable_codec(target, format, where=str(target))
    if not force:
        hint = "Name another file, or replace it with --force."
        refuse_itself(target, [source], hint)
    write = _writer(codec, spz_version, encoding)
    is_reading = True

    def on_step(step: str) -> None:
        nonlocal is_reading
        is_reading = step.startswith("reading")
        progress(step)

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FormatWarning)
        try:
            result = convert_file(
                source,
                target,
                codec,
                sh_degree=sh_degree,
                drop_invalid=drop_invalid,
                write=write,
                step=on_step,
            )
        except FormatError as error:
            clear()
            typer.echo(f"gsgen: {error}", err=True)
            is_unreadable = is_reading and error.path == str(source)
            code = ExitCode.UNREADABLE if is_unreadable else ExitCode.FAILURE
            raise typer.Exit(code) from error
    clear()
    notes = list(dict.fromkeys(str(warning.message) for warning in caught))
    for note in notes:
        typer.echo(f"note: {note}", err=True)
    document = _as_dict(result) | {"notes": notes}
    typer.echo(json.dumps(document, indent=2) if as_json else _as_text(result))


def _writer(
    codec: Codec, spz_version: int | None, encoding: str | None
) -> "Callable[..., None] | None":
    """Return a writer with the options of the splat format; None without options."""
    arguments: dict[str, tuple[str, dict[str, object]]] = {}
    if spz_version is not None:
        arguments["--spz-version"] = "spz", {"version": spz_version}
    if encoding is not None:
        arguments["--encoding"] = "ply", {"format": encoding}
    for option, (format, _) in arguments.items():
        if codec.name != format:
            raise ConfigInvalid(
                f"applies to {format}, but the output is {codec.name}",
                where=option,
                hint="Leave the option out.",
            )
    assert codec.write is not None
    options = {key: value for _, values in arguments.values() for key, value in values.items()}
    return partial(codec.write, **options) if options else None


def _as_dict(result: "Conversion") -> dict[str, object]:
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
    changed = [difference for difference in result.differences if difference.largest]
    if changed:
        lines.append(f"{'off by':<12}{'at most':>12}{'typically':>12}")
    lines += [
        f"  {difference.name:<10}{difference.largest:>12.3g}{difference.typical:>12.3g} {difference.unit}".rstrip()
        for difference in changed
    ]
    if result.degree and not changed and not result.lost:
        lines.append("nothing was lost")
    return "\n".join(lines)
