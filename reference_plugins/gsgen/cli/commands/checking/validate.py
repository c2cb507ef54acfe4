"""The command `gsgen validate`, which checks models against the contract."""

__all__ = ["validate"]

import os
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from gsgen.cli.options import (
    Config,
    FailOn,
    LevelName,
    Memory,
    PrintJsonOption,
    TargetName,
    Timeout,
    complete_rules,
    complete_severities,
)
from gsgen.cli.output import echo, echo_commands, echo_error, echo_text
from gsgen.contract.errors import ConfigInvalid, ExitCode, UnknownName

if TYPE_CHECKING:
    from gsgen.contract.reporters.text import Line
    from gsgen.contract.validation.baseline import Baseline
    from gsgen.contract.validation.report import Entry
    from gsgen.contract.validation.rule import Registry
    from gsgen.contract.validation.settings import Settings


Paths = Annotated[
    list[Path],
    typer.Argument(
        metavar="PATH…",
        help="ONNX files, folders of them, globs; tilesets (.json, .3tz) and their contents "
        "(.glb, .gltf); addresses of them.",
        show_default=False,
    ),
]
IgnoreOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Rule (id or name) whose findings do not count; repeat or separate by commas.",
        autocompletion=complete_rules,
    ),
]
OnlyOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Check only this rule and those that it needs; repeat or use commas.",
        autocompletion=complete_rules,
    ),
]
RequireRules = Annotated[
    list[str] | None,
    typer.Option(
        help="Fail unless this rule was checked; repeat or separate by commas.",
        autocompletion=complete_rules,
    ),
]
SeverityOption = Annotated[
    list[str] | None,
    typer.Option(
        help="RULE=SEVERITY, in place of the rule's own severity; repeatable.",
        metavar="RULE=SEVERITY",
        autocompletion=complete_severities,
    ),
]
BaselineFile = Annotated[
    Path | None, typer.Option(help="An earlier JSON report, whose findings do not fail the model.")
]
Output = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        help="Write the report to a file instead, in the format of its suffix; - is stdout.",
        allow_dash=True,
    ),
]
JobsOption = Annotated[
    int, typer.Option("-j", "--jobs", help="Number of models to validate at once.", min=1)
]
StrictOption = Annotated[
    bool, typer.Option(help="A missing manifest is an error for every target.")
]
Times = Annotated[bool, typer.Option(help="Report how long it took; equal inputs then differ.")]


class Format(StrEnum):
    """Output formats of a validation report: text, JSON, SARIF, JUnit, Markdown, GitHub."""

    TEXT = "text"
    JSON = "json"
    SARIF = "sarif"
    JUNIT = "junit"
    MARKDOWN = "markdown"
    MD = "md"
    GITHUB = "github"
    HTML = "html"


# Format → the module in gsgen.contract.reporters, and its function.
_REPORTER_BY_FORMAT = {
    Format.JSON: ("json_report", "to_json"),
    Format.SARIF: ("sarif", "to_sarif"),
    Format.JUNIT: ("junit", "to_junit"),
    Format.MARKDOWN: ("markdown", "to_markdown"),
    Format.MD: ("markdown", "to_markdown"),
    Format.GITHUB: ("github", "to_github"),
    Format.HTML: ("html", "to_html"),
}


# Suffix of a report's file → its format.
_FORMAT_BY_SUFFIX: Final = {
    "": Format.TEXT,
    ".log": Format.TEXT,
    ".txt": Format.TEXT,
    ".htm": Format.HTML,
    ".html": Format.HTML,
    ".json": Format.JSON,
    ".md": Format.MARKDOWN,
    ".sarif": Format.SARIF,
    ".xml": Format.JUNIT,
}

FormatOption = Annotated[
    Format | None,
    typer.Option(
        help="How to print the report. [default: by the suffix of --output, or text]",
        case_sensitive=False,
    ),
]


def validate(
    paths: Paths,
    level: LevelName = None,
    target: TargetName = None,
    format: FormatOption = None,
    as_json: PrintJsonOption = False,
    fail_on: FailOn = None,
    ignore: IgnoreOption = None,
    only: OnlyOption = None,
    require_rules: RequireRules = None,
    severity: SeverityOption = None,
    config: Config = None,
    baseline: BaselineFile = None,
    output: Output = None,
    jobs: JobsOption = 1,
    strict: StrictOption = False,
    times: Times = False,
    timeout: Timeout = None,
    memory: Memory = None,
    verbose: Annotated[
        bool, typer.Option("-v", "--verbose", help="List every rule, tolerance and probe.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("-q", "--quiet", help="Print one line per model: the verdict.")
    ] = False,
) -> None:
    """Check whether the given ONNX models conform to the Gaussian Generator contract.

    Exits 0 if all conform, 1 if one is invalid or a required rule was not checked, 2 for wrong
    options, 3 if a rule crashed, 4 if a file is not an ONNX model.
    """
    from gsgen.cli.commands.checking.validate_file import every_rule, is_tileset, validate_file
    from gsgen.cli.progress import progress
    from gsgen.contract.process.atomic_files import refuse_missing_folder, refuse_model
    from gsgen.contract.rules.catalogue import installed_rules
    from gsgen.contract.validator import expand_paths, validate_all

    files = expand_paths(paths, is_tileset)
    has_tileset = any(is_tileset(file) for file in files)
    rules = every_rule if has_tileset else installed_rules
    if output:
        refuse_model(output, [*files, *(path for path in (config, baseline) if path)])
        refuse_missing_folder(output)
    if as_json:
        format = Format.JSON
    elif format is None:
        format = _format_of(output) if output else Format.TEXT
    options = {
        "level": level,
        "target": target,
        "fail_on": fail_on,
        "ignore": ignore or (),
        "severity": severity or (),
        "only": only or (),
        "require": require_rules or (),
        "config": config,
        "timeout": timeout,
        "memory": memory,
        "strict": strict,
        "timings": times,
    }
    settings = _settings(rules(), options)
    known_baseline = _baseline(baseline) if baseline else None
    entries = validate_all(
        files, settings, jobs=jobs, progress=progress, validate=validate_file, rules=rules
    )
    if known_baseline:
        entries = [_compare_with_baseline(known_baseline, entry) for entry in entries]
    if format is Format.HTML:
        entries = [_with_pictures(entry, settings) for entry in entries]
    _print(entries, format, output, verbose=verbose, quiet=quiet)
    raise typer.Exit(_exit_code(entries))


def _format_of(output: Path) -> "Format":
    format = _FORMAT_BY_SUFFIX.get(output.suffix.lower())
    if format is None:
        raise ConfigInvalid(
            f"has the suffix {output.suffix}, expected that of a report: "
            f"{', '.join(filter(None, _FORMAT_BY_SUFFIX))}",
            where=str(output),
            hint="Change the suffix, or give --format.",
        )
    return format


def _settings(registry: "Registry", options: dict[str, Any]) -> "Settings":
    """Return validation settings; rule names may be those of model rules or of tileset rules."""
    from gsgen.cli.commands.checking.validate_file import every_rule
    from gsgen.contract.validation.settings_from_options import make_settings

    try:
        return make_settings(registry, **options)
    except UnknownName:
        return make_settings(every_rule(), **options)


def _baseline(path: Path) -> "Baseline":
    from gsgen.contract.validation.baseline import read_baseline

    return read_baseline(path)


def _compare_with_baseline(known_baseline: "Baseline", entry: "Entry") -> "Entry":
    from gsgen.contract.validation.report import Report

    return known_baseline.apply(entry) if isinstance(entry, Report) else entry


def _with_pictures(entry: "Entry", settings: "Settings") -> "Entry":
    from gsgen.contract.tools.pictures import with_picture
    from gsgen.contract.validation.report import Report
    from gsgen.runtime.checks.probe_picture import draw_probe

    return with_picture(entry, settings, draw_probe) if isinstance(entry, Report) else entry


def _print(
    entries: "list[Entry]", format: Format, output: Path | None, *, verbose: bool, quiet: bool
) -> None:
    from gsgen.cli.output import show, write_text
    from gsgen.cli.progress import clear
    from gsgen.contract.process.atomic_files import is_device
    from gsgen.contract.validation.report import Unreadable

    clear()
    for entry in entries:
        if isinstance(entry, Unreadable):
            echo_error(entry.error)
    if format is not Format.TEXT:
        text = _format_entries(entries, format) + "\n"
    elif output:
        text = "".join(f"{line.text}\n" for line in _lines(entries, verbose=verbose, quiet=quiet))
    if output:
        write_text(output, text)
        if not quiet and output != Path("-") and not is_device(output):
            echo(f"wrote {output}")
            show(_lines(entries, quiet=True))
    elif format is Format.TEXT:
        show(_lines(entries, verbose=verbose, quiet=quiet))
    elif format is Format.GITHUB:
        echo_commands(text.removesuffix("\n"))
    else:
        echo_text(text, end="")
    if format is Format.GITHUB:
        _append_job_summary(entries)


def _lines(entries: "list[Entry]", *, verbose: bool = False, quiet: bool) -> "list[Line]":
    from gsgen.contract.reporters.text import render_all

    return render_all(entries, verbose=verbose, quiet=quiet)


def _format_entries(entries: "list[Entry]", format: Format) -> str:
    """Return a validation report in a machine-readable format, such as JSON or SARIF."""
    module, name = _REPORTER_BY_FORMAT[format]
    reporter = getattr(import_module(f"gsgen.contract.reporters.{module}"), name)
    text: str = reporter(entries)
    return text


def _append_job_summary(entries: "list[Entry]") -> None:
    """Append the validation reports to the summary page of a GitHub Actions job."""
    path = os.environ.get("GITHUB_STEP_SUMMARY")
    if path:
        from gsgen.cli.output import append_text

        append_text(Path(path), _format_entries(entries, Format.MARKDOWN) + "\n")


def _exit_code(entries: "list[Entry]") -> ExitCode:
    from gsgen.contract.validation.report import Report, exit_code

    reports = [entry for entry in entries if isinstance(entry, Report)]
    code = exit_code(reports)
    has_unreadable_file = len(reports) < len(entries)
    return ExitCode.UNREADABLE if has_unreadable_file and code != ExitCode.INTERNAL else code
