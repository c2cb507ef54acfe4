"""`gsgen fix`: repair what has one right answer."""

__all__ = ["fix"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid, GsgenError, ModelUnreadable

if TYPE_CHECKING:
    from gsgen.contract.manifest import GeneratorManifest

_UNREADABLE = 4


def fix(
    model: Annotated[Path, typer.Argument(help="The ONNX file.", show_default=False)],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The repaired copy.", show_default=False)
    ],
    pin: Annotated[
        list[str] | None,
        typer.Option(help="SYMBOL=SIZE: give a symbolic dimension a size; repeatable."),
    ] = None,
    manifest: Annotated[
        Path | None, typer.Option(help="JSON file with the manifest to embed.")
    ] = None,
    rename: Annotated[
        bool, typer.Option("--rename", help="Give outputs the names that viewers look for.")
    ] = False,
    sh_order: Annotated[
        Literal["channel-major"] | None,
        typer.Option(
            help="What order the SH really have; they are reordered. Never guessed."
        ),
    ] = None,
) -> None:
    """Write a repaired copy of MODEL, and list what was changed.

    Exits 0 if the copy conforms, 1 if findings remain or nothing could be repaired, 4 if MODEL is
    no model.
    """
    from gsgen.contract.commands.output import show
    from gsgen.contract.reporters.text import render
    from gsgen.sdk.repair import Request, repair

    request = Request(
        sizes=dict(_pinned(entry) for entry in pin or ()),
        manifest=_manifest(manifest) if manifest else None,
        rename=rename,
        channel_major=sh_order is not None,
    )
    try:
        done = repair(model, output, request)
    except ModelUnreadable as error:
        typer.echo(f"gsgen: {error}", err=True)
        raise typer.Exit(_UNREADABLE) from error
    except ConfigInvalid:
        raise
    except GsgenError as error:
        typer.echo(f"gsgen: {error}", err=True)
        raise typer.Exit(1) from error
    for one in done.repairs:
        typer.echo(f"{one.rule}: {one.what}")
    show(render(done.after))
    raise typer.Exit(0 if done.after.verdict == "conforms" else 1)


def _pinned(entry: str) -> tuple[str, int]:
    symbol, sign, size = entry.partition("=")
    if not sign or not (size.isascii() and size.isdigit() and int(size) > 0):
        raise ConfigInvalid(f"{entry!r} is not SYMBOL=SIZE, such as N=65536", where="--pin")
    return symbol, int(size)


def _manifest(path: Path) -> "GeneratorManifest":
    from gsgen.contract.manifest import GeneratorManifest
    from gsgen.contract.manifest_json import loads

    try:
        made = loads(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigInvalid(f"cannot be read: {error}", where=str(path)) from error
    except GsgenError as error:
        raise ConfigInvalid(error.what, where=str(path)) from error
    if not isinstance(made, GeneratorManifest):
        raise ConfigInvalid(
            f"is a {made.kind}, wanted a gaussian-generator", where=str(path)
        )
    return made
