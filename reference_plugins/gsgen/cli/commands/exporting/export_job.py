"""Runs `gsgen export`: builds the module or scene, exports it, and prints the result."""

__all__ = ["run_export"]

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TextIO

import typer

from gsgen.cli.output import echo, echo_error
from gsgen.cli.progress import clear, progress
from gsgen.contract.errors import ConfigInvalid, FileNote, GsgenError

if TYPE_CHECKING:
    from gsgen.cli.commands.exporting.export_options import ExportRequest
    from gsgen.sdk.exporting.pipeline import Exported, StageClock


def run_export(build: Callable[[], Any], request: "ExportRequest", source: str) -> None:
    """Build a torch module or scene, export it, and print the validator's findings.

    Exits with code 1 if no conforming model can be exported.
    """
    from gsgen.cli.commands.exporting.export_report import ExportOutcome, emit_report
    from gsgen.contract.process.interrupts import OutOfTime, time_limit
    from gsgen.sdk.errors import (
        ExportFailed,
        ExportRejected,
        GeneratorInvalid,
        ParityFailed,
        RewriteFailed,
    )
    from gsgen.sdk.exporting.pipeline import StageClock

    level_faults = (ExportFailed, ExportRejected, GeneratorInvalid, ParityFailed, RewriteFailed)
    clock = StageClock(progress)
    late_message = (
        f"gsgen: out of time after {request.timeout or 0:g} s (--timeout), within one call into C++\n"
        f"gsgen: {request.output} was not written"
    )
    try:
        with _collected_warnings() as warning_notes, time_limit(request.timeout, late_message):
            try:
                result = _run_export_job(build, request, clock)
            except OutOfTime as error:
                stages = clock.stages()
                stage_name = stages[-1].name if stages else "building the generator"
                spent = ", ".join(f"{stage.name} {stage.cpu_seconds:.0f} CPU-s" for stage in stages)
                hint = f"Give more with --timeout. Used: {spent or 'nothing'}."
                raise ExportFailed(f"{error}, {stage_name}", hint=hint) from error
    except level_faults as error:
        clear()
        outcome = ExportOutcome(
            written=False,
            report=error.report if isinstance(error, ExportRejected) else None,
            parity=error.parity if isinstance(error, ParityFailed) else None,
            stages=clock.stages(),
            error=error,
        )
        emit_report(replace(request, dtype=request.dtype or "float32"), source, outcome)
        if not request.as_json:
            _show_failure(error)
        echo(f"gsgen: {request.output} was not written", err=True)
        raise typer.Exit(1) from error
    clear()
    for note in (*result.notes, *warning_notes):
        echo(f"note: {note}", err=True)
    outcome = ExportOutcome(
        written=True,
        report=result.report,
        parity=result.parity,
        changes=result.changes,
        notes=result.notes,
        stages=result.stages,
        folded=result.folded,
        measured=result.measured,
    )
    emit_report(replace(request, dtype=result.dtype), source, outcome)
    if not request.as_json:
        _show_result(result)


@contextmanager
def _collected_warnings() -> Iterator[list[str]]:
    """Keep the warnings of the module's code off the screen; give them as one line at the end."""
    notes: list[str] = []
    texts: dict[str, None] = {}
    show = warnings.showwarning

    def collect(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if issubclass(category, FileNote):
            show(message, category, filename, lineno, file, line)
        else:
            texts[f"{category.__name__}: {' '.join(str(message).split())[:120]}"] = None

    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.simplefilter("always", FileNote)
        warnings.showwarning = collect
        yield notes
    if texts:
        more = f", and {len(texts) - 1} more" if len(texts) > 1 else ""
        notes.append(f"the module's code warns: {next(iter(texts))}{more}")


def _run_export_job(
    build: Callable[[], Any], request: "ExportRequest", clock: "StageClock"
) -> "Exported":
    """Check the options, build the torch module or scene, and export it by its kind."""
    from gsgen.contract.process.limits import Limits
    from gsgen.contract.spec.severity import Level
    from gsgen.contract.spec.targets import load_target
    from gsgen.contract.validation.settings import Settings
    from gsgen.sdk.exporting.pipeline import GraphSource

    # Options are checked before a slow step begins.
    request.refuse_splat_file()
    limits = Limits() if request.timeout is None else Limits(seconds=request.timeout)
    settings = Settings(level=Level.parse(request.level, "--level"), limits=limits)
    load_target(request.target)
    clock.begin("building the generator")
    module = _build_generator(build)
    options: dict[str, Any] = {
        "name": request.name,
        "opset": request.opset,
        "target": request.target,
        "settings": settings,
        "progress": clock,
    }
    # Case 1: a scene that does not change, or a clip; torch may be absent.
    if isinstance(module, GraphSource):
        _refuse_pictures(request)
        return module.export(
            request.output, dtype=request.dtype, capacity=request.capacity, **options
        )
    from gsgen.sdk.authoring.post_process import PostProcess
    from gsgen.sdk.exporting.exporter import export
    from gsgen.sdk.exporting.post_process_exporter import export_post_process

    options |= {"rewrite": request.rewrite, "skip": request.skip}
    # Case 2: a model from image to image.
    if isinstance(module, PostProcess):
        _refuse_pictures(request)
        if request.capacity is not None:
            message = "a post-process model returns an image, which has no Gaussians"
            raise ConfigInvalid(message, where="--capacity", hint="Leave the option out.")
        dtype = request.dtype or "float32"
        return export_post_process(module, request.output, dtype=dtype, **options)
    # Case 3: a generator.
    options |= {"dtype": request.dtype, "capacity": request.capacity, "verify": request.verify}
    options["vectors"] = request.vectors
    if request.pictures:
        from gsgen.runtime.checks.eager_pictures import draw_source_frames
        from gsgen.sdk.source_pictures import SourcePictures

        options["pictures"] = SourcePictures(request.pictures, draw_source_frames)
    return export(module, request.output, **options)


def _refuse_pictures(request: "ExportRequest") -> None:
    """Raise if pictures of a torch module are requested for a scene that has no torch module."""
    if request.pictures:
        message = "only a generator in torch has an eager module to draw"
        hint = "Leave it out; `gsgen references --from` takes pictures of the training code."
        raise ConfigInvalid(message, where="--pictures", hint=hint)


def _build_generator(build: Callable[[], Any]) -> Any:
    from gsgen.sdk.plugins.factory import require_torch

    try:
        return build()
    except ModuleNotFoundError:
        require_torch()
        raise


def _show_failure(error: GsgenError) -> None:
    from gsgen.cli.output import show
    from gsgen.contract.reporters.text import render
    from gsgen.sdk.errors import ExportRejected

    if isinstance(error, ExportRejected):
        show(render(error.report))
    else:
        echo_error(error)


def _show_result(result: "Exported") -> None:
    from gsgen.cli.output import show
    from gsgen.contract.reporters.text import render
    from gsgen.contract.spec.units import format_bytes

    report = result.report
    if report.findings or any(not level.ran for level in report.levels):
        show(render(report))
    size = format_bytes(result.path.stat().st_size)
    echo(f"{result.path}: {result.contents}, {size}; {_verdict_text(result)}")
    for line in result.lines:
        echo(line)
    if result.changes:
        rewrites = ", ".join(f"{change.rewrite} ({len(change.nodes)})" for change in result.changes)
        echo(f"rewritten: {rewrites}")
    if result.parity is not None:
        probes = "probe" if result.parity.probes == 1 else "probes"
        echo(f"agrees with torch at {result.parity.probes} {probes}: {result.parity.describe()}")


def _verdict_text(result: "Exported") -> str:
    report = result.report
    if report.verdict != "conforms":
        return "does NOT conform; the packed Gaussians were passed through unchanged"
    completed_levels = [level.level.word for level in report.levels if level.ran]
    skipped = [level.level.word for level in report.levels if not level.ran]
    suffix = f", {' and '.join(skipped)} skipped" if skipped else ""
    return f"conforms at level {completed_levels[-1]}{suffix}"
