"""What `gsgen export` does once it knows what to export: do it, and say how it went."""

__all__ = ["run_export"]

from collections.abc import Callable
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import typer

from gsgen.contract.commands.progress import clear, progress
from gsgen.contract.errors import ConfigInvalid, GsgenError

if TYPE_CHECKING:
    from gsgen.sdk.exporting.exporter import Exported
    from gsgen.sdk.exporting.post_process_exporter import ExportedImage
    from gsgen.sdk.plugins.export_options import ExportRequest


def run_export(build: Callable[[], Any], request: "ExportRequest", source: str) -> None:
    """Build a generator and export it; show what the validator found.

    Args:
        build: Makes the generator.
        request: Where it goes, and how.
        source: What was asked for: a plugin's name or ``module:factory``.

    Raises:
        typer.Exit: With code 1, where the module cannot be exported as a model that conforms.
        GsgenError: Torch is not installed, or an option cannot be meant.
    """
    if find_spec("torch") is None:
        what = "`gsgen export` needs torch, which is not installed"
        raise GsgenError(what, hint="pip install 'gsgen[sdk]'")
    from gsgen.sdk.errors import (
        ExportFailed,
        ExportRejected,
        GeneratorInvalid,
        ParityFailed,
        RewriteFailed,
    )
    from gsgen.sdk.plugins.export_report import Outcome, write_report

    faults = (ExportFailed, ExportRejected, GeneratorInvalid, ParityFailed, RewriteFailed)
    try:
        made = _export(build, request)
    except faults as error:
        clear()
        if request.report is not None:
            report = error.report if isinstance(error, ExportRejected) else None
            parity = error.parity if isinstance(error, ParityFailed) else None
            outcome = Outcome(False, report, parity, error=error)
            write_report(request.report, request, source, outcome)
        _show_failure(error)
        typer.echo(f"gsgen: {request.output} was not written", err=True)
        raise typer.Exit(1) from error
    clear()
    if request.report is not None:
        outcome = Outcome(True, made.report, made.parity, made.changes)
        write_report(request.report, request, source, outcome)
    _show(made)


def _export(
    build: Callable[[], Any], request: "ExportRequest"
) -> "Exported | ExportedImage":
    from gsgen.contract.spec.severity import Level
    from gsgen.contract.spec.targets import load_target
    from gsgen.contract.validation.settings import Settings
    from gsgen.sdk.authoring.post_process import PostProcess
    from gsgen.sdk.exporting.exporter import export
    from gsgen.sdk.exporting.post_process_exporter import export_post_process

    # Options are judged before anything slow begins.
    settings = Settings(level=Level.parse(request.level, "--level"))
    load_target(request.target)
    progress("building the generator")
    made = build()
    if isinstance(made, PostProcess):
        if request.capacity is not None:
            what = "a post-process model has an image, and no rows"
            raise ConfigInvalid(what, where="--capacity", hint="Leave the option out.")
        return export_post_process(
            made,
            request.output,
            name=request.name,
            dtype=request.dtype,
            opset=request.opset,
            target=request.target,
            rewrite=request.rewrite,
            settings=settings,
            progress=progress,
        )
    exported = export(
        made,
        request.output,
        name=request.name,
        dtype=request.dtype,
        capacity=request.capacity,
        opset=request.opset,
        target=request.target,
        rewrite=request.rewrite,
        settings=settings,
        progress=progress,
    )
    for note in exported.notes:
        _note(f"note: {note}")
    return exported


def _note(text: str) -> None:
    clear()
    typer.echo(text, err=True)


def _show_failure(error: GsgenError) -> None:
    from gsgen.contract.commands.output import show
    from gsgen.contract.reporters.text import render
    from gsgen.sdk.errors import ExportRejected

    if isinstance(error, ExportRejected):
        show(render(error.report))
    else:
        typer.echo(f"gsgen: {error}", err=True)


def _show(made: "Exported | ExportedImage") -> None:
    from gsgen.contract.commands.output import show
    from gsgen.contract.reporters.text import render

    if made.report.findings or any(not level.ran for level in made.report.levels):
        show(render(made.report))
    kib = made.path.stat().st_size / 1024
    size = f"{kib:.1f} KiB" if kib < 1024 else f"{kib / 1024:.1f} MiB"
    ran = [level.level.word for level in made.report.levels if level.ran]
    skipped = [level.level.word for level in made.report.levels if not level.ran]
    lacking = f", {' and '.join(skipped)} skipped" if skipped else ""
    typer.echo(
        f"{made.path}: {made.contents}, {size}; conforms at level {ran[-1]}{lacking}"
    )
    if made.changes:
        listed = ", ".join(f"{one.rewrite} ({len(one.nodes)})" for one in made.changes)
        typer.echo(f"rewritten: {listed}")
    typer.echo(
        f"agrees with torch at {made.parity.probes} "
        f"{'probe' if made.parity.probes == 1 else 'probes'}: {made.parity.describe()}"
    )
