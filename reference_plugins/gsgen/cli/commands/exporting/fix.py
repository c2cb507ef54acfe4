"""`gsgen fix`: repair a model that violates rules, where only one repair is possible."""

__all__ = ["fix"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.cli.model_options import (
    DryRun,
    ModelFile,
    PrintJsonOption,
    Sizes,
    copy_of,
    exit_at_error,
    sizes_of,
)
from gsgen.cli.output import echo, echo_json
from gsgen.contract.errors import ConfigInvalid, ExitCode, GsgenError

if TYPE_CHECKING:
    from gsgen.contract.spec.manifest import GeneratorManifest
    from gsgen.sdk.exporting.repair import RepairResult


def fix(
    model: ModelFile,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The repaired copy.")
    ] = None,
    size: Sizes = None,
    manifest: Annotated[
        Path | None, typer.Option(help="JSON file with the manifest to embed.")
    ] = None,
    rename: Annotated[
        bool,
        typer.Option(
            "--rename", help="Give outputs the names that viewers expect, and list them first."
        ),
    ] = False,
    sh_order: Annotated[
        Literal["channel-major"] | None,
        typer.Option(help="Actual order of the SH, which are then reordered; never guessed."),
    ] = None,
    dry_run: DryRun = False,
    as_json: PrintJsonOption = False,
) -> None:
    """Write a repaired copy of MODEL, and list the changes.

    Exits 0 if the copy conforms, 1 if findings remain or nothing could be repaired, 4 if MODEL is
    not a model.
    """
    from gsgen.cli.output import show
    from gsgen.contract.process.atomic_files import refuse_itself
    from gsgen.contract.reporters.text import render
    from gsgen.sdk.exporting.repair import RepairRequest, repair

    output = copy_of(output, dry_run=dry_run)
    if output is not None and manifest is not None:
        refuse_itself(output, [manifest])
    request = RepairRequest(
        sizes=sizes_of(size),
        manifest=_manifest(manifest) if manifest else None,
        rename=rename,
        channel_major=sh_order is not None,
    )
    with exit_at_error():
        result = repair(model, output, request)
    if as_json:
        echo_json(_document(result, output))
    else:
        for applied_repair in result.repairs:
            echo(f"{applied_repair.rule}: {applied_repair.description}")
        show(render(result.after))
    raise typer.Exit(ExitCode.SUCCESS if result.after.verdict == "conforms" else ExitCode.FAILURE)


def _document(result: "RepairResult", output: Path | None) -> dict[str, object]:
    from gsgen.contract.reporters.json_report import to_dict

    return {
        "path": str(output) if output else None,
        "repairs": [
            {"description": applied_repair.description, "rule": applied_repair.rule}
            for applied_repair in result.repairs
        ],
        "before": to_dict(result.before),
        "after": to_dict(result.after),
    }


def _manifest(path: Path) -> "GeneratorManifest":
    from gsgen.contract._safe_text import read_utf8
    from gsgen.contract.spec.manifest import GeneratorManifest
    from gsgen.contract.spec.manifest_io import loads

    try:
        manifest = loads(read_utf8(path))
    except (OSError, UnicodeError) as error:
        raise ConfigInvalid(f"the manifest cannot be read: {error}", where=str(path)) from error
    except GsgenError as error:
        raise ConfigInvalid(error.message, where=str(path)) from error
    if not isinstance(manifest, GeneratorManifest):
        raise ConfigInvalid(
            f"the manifest is that of a {manifest.kind}, expected a gaussian-generator",
            where=str(path),
        )
    return manifest
