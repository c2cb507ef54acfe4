"""`gsgen fix`: repair what has one right answer."""

__all__ = ["fix"]

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid, GsgenError, ModelUnreadable

if TYPE_CHECKING:
    from gsgen.contract.spec.manifest import GeneratorManifest
    from gsgen.sdk.exporting.repair import Repaired

_UNREADABLE = 4


def fix(
    model: Annotated[Path, typer.Argument(help="The ONNX file.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The repaired copy.")
    ] = None,
    size: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SYMBOL=SIZE", help="Give an open dimension a size; repeatable."
        ),
    ] = None,
    pin: Annotated[
        list[str] | None, typer.Option(hidden=True, help="What --size was called.")
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
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Write nothing; say what would change.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Write a repaired copy of MODEL, and list what was changed.

    Exits 0 if the copy conforms, 1 if findings remain or nothing could be repaired, 4 if MODEL is
    no model.
    """
    from gsgen.contract.commands.output import show
    from gsgen.contract.reporters.text import render
    from gsgen.sdk.commands.copies import copy_of
    from gsgen.sdk.commands.sizes import sizes_of
    from gsgen.sdk.exporting.repair import Request, repair

    output = copy_of(output, dry_run)
    request = Request(
        sizes=sizes_of(size, "--size") | sizes_of(pin, "--pin"),
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
    if as_json:
        typer.echo(json.dumps(_document(done, output), indent=2, ensure_ascii=False))
    else:
        for one in done.repairs:
            typer.echo(f"{one.rule}: {one.what}")
        show(render(done.after))
    raise typer.Exit(0 if done.after.verdict == "conforms" else 1)


def _document(done: "Repaired", output: Path | None) -> dict[str, object]:
    from gsgen.contract.reporters.json_report import to_dict

    return {
        "path": str(output) if output else None,
        "repairs": [asdict(one) for one in done.repairs],
        "before": to_dict(done.before),
        "after": to_dict(done.after),
    }


def _manifest(path: Path) -> "GeneratorManifest":
    from gsgen.contract.spec.manifest import GeneratorManifest
    from gsgen.contract.spec.manifest_io import loads

    try:
        made = loads(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigInvalid(f"cannot be read: {error}", where=str(path)) from error
    except GsgenError as error:
        raise ConfigInvalid(error.message, where=str(path)) from error
    if not isinstance(made, GeneratorManifest):
        raise ConfigInvalid(
            f"is a {made.kind}, wanted a gaussian-generator", where=str(path)
        )
    return made
