"""`gsgen fix`: repair outputs that violate a rule, where only one repair is possible."""

__all__ = ["fix"]

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid, ExitCode, GsgenError, ModelUnreadable

if TYPE_CHECKING:
    from gsgen.contract.spec.manifest import GeneratorManifest
    from gsgen.sdk.exporting.repair import RepairResult


def fix(
    model: Annotated[Path, typer.Argument(help="The ONNX file.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The repaired copy.")
    ] = None,
    size: Annotated[
        list[str] | None,
        typer.Option(metavar="SYMBOL=SIZE", help="Size of an open dimension; repeatable."),
    ] = None,
    pin: Annotated[
        list[str] | None, typer.Option(hidden=True, help="Former name of --size.")
    ] = None,
    manifest: Annotated[
        Path | None, typer.Option(help="JSON file with the manifest to embed.")
    ] = None,
    rename: Annotated[
        bool, typer.Option("--rename", help="Rename outputs to the names that viewers expect.")
    ] = False,
    sh_order: Annotated[
        Literal["channel-major"] | None,
        typer.Option(help="Actual order of the SH, which are then reordered; never guessed."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Write nothing; list the changes.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Write a repaired copy of MODEL, and list the changes.

    Exits 0 if the copy conforms, 1 if findings remain or nothing could be repaired, 4 if MODEL is
    not a model.
    """
    from gsgen.contract.commands.output import show
    from gsgen.contract.reporters.text import render
    from gsgen.sdk.commands.copies import copy_of
    from gsgen.sdk.commands.sizes import sizes_of
    from gsgen.sdk.exporting.repair import RepairRequest, repair

    output = copy_of(output, dry_run=dry_run)
    request = RepairRequest(
        sizes=sizes_of(size, "--size") | sizes_of(pin, "--pin"),
        manifest=_manifest(manifest) if manifest else None,
        rename=rename,
        channel_major=sh_order is not None,
    )
    try:
        result = repair(model, output, request)
    except ModelUnreadable as error:
        typer.echo(f"gsgen: {error}", err=True)
        raise typer.Exit(ExitCode.UNREADABLE) from error
    except ConfigInvalid:
        raise
    except GsgenError as error:
        typer.echo(f"gsgen: {error}", err=True)
        raise typer.Exit(ExitCode.FAILURE) from error
    if as_json:
        typer.echo(json.dumps(_document(result, output), indent=2, ensure_ascii=False))
    else:
        for applied in result.repairs:
            typer.echo(f"{applied.rule}: {applied.description}")
        show(render(result.after))
    raise typer.Exit(ExitCode.SUCCESS if result.after.verdict == "conforms" else ExitCode.FAILURE)


def _document(result: "RepairResult", output: Path | None) -> dict[str, object]:
    from gsgen.contract.reporters.json_report import to_dict

    return {
        "path": str(output) if output else None,
        "repairs": [
            {"what": applied.description, "rule": applied.rule} for applied in result.repairs
        ],
        "before": to_dict(result.before),
        "after": to_dict(result.after),
    }


def _manifest(path: Path) -> "GeneratorManifest":
    from gsgen.contract.spec.manifest import GeneratorManifest
    from gsgen.contract.spec.manifest_io import loads

    try:
        manifest = loads(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigInvalid(f"cannot be read: {error}", where=str(path)) from error
    except GsgenError as error:
        raise ConfigInvalid(error.message, where=str(path)) from error
    if not isinstance(manifest, GeneratorManifest):
        raise ConfigInvalid(f"is a {manifest.kind}, expected a gaussian-generator", where=str(path))
    return manifest
