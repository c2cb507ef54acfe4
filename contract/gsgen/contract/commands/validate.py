"""The command `gsgen validate`, which checks models against the contract."""

__all__ = ["validate"]

import os
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.commands.options import (
    AsJson,
    Config,
    FailOn,
    LevelName,
    Memory,
    TargetName,
    Timeout,
)
from gsgen.contract.errors import ExitCode, InputUnreadable

if TYPE_CHECKING:
    from gsgen.contract.validation.baseline import Baseline
    from gsgen.contract.validation.report import Entry
    from gsgen.contract.validation.rule import Registry
    from gsgen.contract.validation.settings import Settings


class Format(StrEnum):
    """Output formats of a validation report: text, JSON, SARIF, JUnit, Markdown, GitHub."""

    TEXT = "text"
    JSON = "json"
    SARIF = "sarif"
    JUNIT = "junit"
    MARKDOWN = "markdown"
    MD = "md"
    GITHUB = "github"


# Format → the module in gsgen.contract.reporters, and its function.
_REPORTERS = {
    Format.JSON: ("json_report", "to_json"),
    Format.SARIF: ("sarif", "to_sarif"),
    Format.JUNIT: ("junit", "to_junit"),
    Format.MARKDOWN: ("markdown", "to_markdown"),
    Format.MD: ("markdown", "to_markdown"),
    Format.GITHUB: ("github", "to_github"),
}


def validate(
    models: Annotated[
        list[Path],
        typer.Argument(
            help="ONNX files; tilesets (.json, .3tz) and their contents (.glb, .gltf).",
            show_default=False,
        ),
    ],
    level: LevelName = None,
    target: TargetName = None,
    format: Annotated[Format, typer.Option(help="How to print the report.")] = Format.TEXT,
    as_json: AsJson = False,
    fail_on: FailOn = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            help="Rule (id or name) whose findings do not count; repeat or separate by commas."
        ),
    ] = None,
    severity: Annotated[
        list[str] | None,
        typer.Option(
            help="RULE=SEVERITY, in place of the rule's own severity; repeatable.",
            metavar="ID=LEVEL",
        ),
    ] = None,
    config: Config = None,
    baseline: Annotated[
        Path | None,
        typer.Option(help="An earlier JSON report, whose findings do not fail the model."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the report to a file instead.")
    ] = None,
    strict: Annotated[bool, typer.Option(help="A missing manifest is an error.")] = False,
    timeout: Timeout = None,
    memory: Memory = None,
    verbose: Annotated[
        bool, typer.Option("-v", "--verbose", help="List every rule, tolerance and probe.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("-q", "--quiet", help="Print one line per model: the verdict.")
    ] = False,
) -> None:
    """Check whether each MODEL conforms to the contract.

    Exits 0 if all conform, 1 if one is invalid, 2 for wrong options, 3 if a rule crashed, 4 if a
    file is not an ONNX model.
    """
    from gsgen.contract.process.atomic_files import refuse_model
    from gsgen.contract.rules.catalogue import installed_rules
    from gsgen.contract.validation.settings_from_options import make_settings

    if output:
        refuse_model(output, models)
    registry = installed_rules()
    settings = make_settings(
        registry,
        level=level,
        target=target,
        fail_on=fail_on,
        ignore=ignore or (),
        severity=severity or (),
        config=config,
        timeout=timeout,
        memory=memory,
        strict=strict,
    )
    format = Format.JSON if as_json else format
    known = _baseline(baseline) if baseline else None
    entries = [_validated(model, settings, registry, known) for model in models]
    _print(entries, format, output, verbose=verbose, quiet=quiet)
    raise typer.Exit(_exit_code(entries))


def _baseline(path: Path) -> "Baseline":
    from gsgen.contract.validation.baseline import read_baseline

    return read_baseline(path)


def _validated(
    model: Path, settings: "Settings", registry: "Registry", known: "Baseline | None"
) -> "Entry":
    from gsgen.contract.commands.progress import progress
    from gsgen.contract.validation.report import Unreadable
    from gsgen.contract.validator import validate as validate_model

    try:
        report = validate_model(model, settings, registry=registry, progress=progress)
    except InputUnreadable as error:
        return Unreadable(str(model), error)
    return known.apply(report) if known else report


def _print(
    entries: "list[Entry]", format: Format, output: Path | None, *, verbose: bool, quiet: bool
) -> None:
    from gsgen.contract.commands.output import show, write_text
    from gsgen.contract.commands.progress import clear
    from gsgen.contract.validation.report import Unreadable

    clear()
    for entry in entries:
        if isinstance(entry, Unreadable):
            typer.echo(f"gsgen: {entry.error}", err=True)
    if format is not Format.TEXT:
        text = _rendered(entries, format)
        write_text(output, text + "\n") if output else typer.echo(text)
        if format is Format.GITHUB:
            _summarise(entries)
        return
    from gsgen.contract.reporters.text import render_all

    lines = render_all(entries, verbose=verbose, quiet=quiet)
    if output:
        write_text(output, "".join(line.text + "\n" for line in lines))
    else:
        show(lines)


def _rendered(entries: "list[Entry]", format: Format) -> str:
    """Return a validation report in a machine-readable format; only that reporter is imported."""
    module, name = _REPORTERS[format]
    reporter = getattr(import_module(f"gsgen.contract.reporters.{module}"), name)
    text: str = reporter(entries)
    return text


def _summarise(entries: "list[Entry]") -> None:
    """Append the validation reports to the summary page of a GitHub Actions job."""
    path = os.environ.get("GITHUB_STEP_SUMMARY")
    if path:
        from gsgen.contract.commands.output import append_text

        append_text(Path(path), _rendered(entries, Format.MARKDOWN) + "\n")


def _exit_code(entries: "list[Entry]") -> ExitCode:
    from gsgen.contract.validation.report import Report, exit_code

    reports = [entry for entry in entries if isinstance(entry, Report)]
    code = exit_code(reports)
    unreadable = len(reports) < len(entries)
    return ExitCode.UNREADABLE if unreadable and code != ExitCode.INTERNAL else code
