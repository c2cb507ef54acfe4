"""`gsgen validate`: judge models by the contract."""

__all__ = ["validate"]

import os
import sys
from dataclasses import replace
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.errors import ConfigInvalid, ModelUnreadable

if TYPE_CHECKING:
    from gsgen.contract.baseline import Baseline
    from gsgen.contract.config import Settings
    from gsgen.contract.finding import Severity
    from gsgen.contract.report import Entry
    from gsgen.contract.rule import Registry

_UNREADABLE = 4
_INTERNAL = 3
_DEFAULT_CONFIG = Path("gsgen.toml")


class Format(StrEnum):
    """How a report is printed."""

    TEXT = "text"
    JSON = "json"
    SARIF = "sarif"
    JUNIT = "junit"
    MARKDOWN = "markdown"
    MD = "md"
    GITHUB = "github"


# Format → the module in gsgen.contract.reporters, and its function.
_REPORTERS = {
    Format.JSON: ("machine", "to_json"),
    Format.SARIF: ("sarif", "to_sarif"),
    Format.JUNIT: ("junit", "to_junit"),
    Format.MARKDOWN: ("markdown", "to_markdown"),
    Format.MD: ("markdown", "to_markdown"),
    Format.GITHUB: ("github", "to_github"),
}


def validate(
    models: Annotated[list[Path], typer.Argument(help="ONNX files.", show_default=False)],
    level: Annotated[
        str | None,
        typer.Option(
            help="How far to go: static, values, behaviour, live or render.",
            show_default="behaviour",
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            help="Consumer to judge for: core, webgpu, visionary, gsgen.",
            show_default="core",
        ),
    ] = None,
    format: Annotated[Format, typer.Option(help="How to print the report.")] = Format.TEXT,
    fail_on: Annotated[
        str | None,
        typer.Option(
            help="Lowest severity that fails: error, warning or info.", show_default="error"
        ),
    ] = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            help="Rule (id or name) whose findings do not count; repeat or separate by commas."
        ),
    ] = None,
    severity: Annotated[
        list[str] | None,
        typer.Option(
            help="RULE=SEVERITY, over what the rule says; repeatable.", metavar="ID=LEVEL"
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            help="Configuration file.", show_default="./gsgen.toml, where there is one"
        ),
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(help="An earlier JSON report: what it lists does not fail again."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write the report to a file instead."),
    ] = None,
    strict: Annotated[bool, typer.Option(help="A missing manifest is an error.")] = False,
    timeout: Annotated[
        float | None,
        typer.Option(
            help="Seconds that running a model may take.", show_default="120", min=0.1
        ),
    ] = None,
    memory: Annotated[
        int | None,
        typer.Option(
            help="MiB of memory that running a model may take.", show_default="2048", min=64
        ),
    ] = None,
    verbose: Annotated[
        bool,
        typer.Option("-v", "--verbose", help="List every rule, tolerance and probe."),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("-q", "--quiet", help="Print one line a model: the verdict.")
    ] = False,
) -> None:
    """Say whether each MODEL keeps the contract.

    Exits 0 if all conform, 1 if not, 2 for wrong options, 3 if a rule crashed, 4 if no model.
    """
    from gsgen.contract.installed import installed_rules

    registry = installed_rules()
    settings = _settings(registry, config, level, target, fail_on, ignore, severity)
    limits = settings.limits
    limits = replace(limits, seconds=timeout) if timeout else limits
    limits = replace(limits, memory=memory << 20) if memory else limits
    settings = replace(settings, limits=limits, strict=strict or settings.strict)
    known = _baseline(baseline) if baseline else None
    entries = [_judge(model, settings, registry, known) for model in models]
    _print(entries, format, output, verbose, quiet)
    raise typer.Exit(_exit_code(entries))


def _settings(
    registry: "Registry",
    config: Path | None,
    level: str | None,
    target: str | None,
    fail_on: str | None,
    ignore: list[str] | None,
    severity: list[str] | None,
) -> "Settings":
    from gsgen.contract.config import Settings, read_config
    from gsgen.contract.finding import Level, Severity
    from gsgen.contract.targets import load_target

    base = Settings()
    path = config or (_DEFAULT_CONFIG if _DEFAULT_CONFIG.is_file() else None)
    if path is not None:
        base = read_config(path, registry, base)
    names = [name for entry in ignore or () for name in entry.split(",") if name]
    ignored = {registry.find(name, "--ignore").id for name in names}
    return replace(
        base,
        level=Level.parse(level, "--level") if level else base.level,
        target=load_target(target) if target else base.target,
        fail_on=Severity.parse(fail_on, "--fail-on") if fail_on else base.fail_on,
        ignore=base.ignore | ignored,
        severities={**base.severities, **_severities(registry, severity or [])},
    )


def _severities(registry: "Registry", entries: list[str]) -> "dict[str, Severity]":
    from gsgen.contract.finding import Severity

    made: dict[str, Severity] = {}
    for entry in entries:
        name, sign, word = entry.partition("=")
        if not sign:
            mend = "Write it as GV004=error."
            raise ConfigInvalid(f"{entry!r} has no '='", where="--severity", mend=mend)
        made[registry.find(name, "--severity").id] = Severity.parse(word, "--severity")
    return made


def _baseline(path: Path) -> "Baseline":
    from gsgen.contract.baseline import read_baseline

    return read_baseline(path)


def _judge(
    model: Path, settings: "Settings", registry: "Registry", known: "Baseline | None"
) -> "Entry":
    from gsgen.contract.engine import validate as judge
    from gsgen.contract.report import Unreadable

    try:
        report = judge(model, settings, registry=registry, progress=_progress)
    except ModelUnreadable as error:
        return Unreadable(str(model), error)
    return known.applied(report) if known else report


def _progress(words: str) -> None:
    """Show what is being done, where someone is watching."""
    if sys.stderr.isatty():
        typer.echo(f"\r\x1b[2K{words} …", err=True, nl=False)


def _print(
    entries: "list[Entry]",
    format: Format,
    output: Path | None,
    verbose: bool,
    quiet: bool,
) -> None:
    from gsgen.contract.commands.output import show, write_text
    from gsgen.contract.report import Unreadable

    if sys.stderr.isatty():
        typer.echo("\r\x1b[2K", err=True, nl=False)
    for entry in entries:
        if isinstance(entry, Unreadable):
            typer.echo(f"gsgen: {entry.error}", err=True)
    if format is not Format.TEXT:
        made = _rendered(entries, format)
        write_text(output, made + "\n") if output else typer.echo(made)
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
    """Return what a program reads; only the reporter that is asked for is imported."""
    module, name = _REPORTERS[format]
    reporter = getattr(import_module(f"gsgen.contract.reporters.{module}"), name)
    made: str = reporter(entries)
    return made


def _summarise(entries: "list[Entry]") -> None:
    """Add the reports to the job's summary page, where GitHub Actions has one."""
    path = os.environ.get("GITHUB_STEP_SUMMARY")
    if path:
        from gsgen.contract.commands.output import append_text

        append_text(Path(path), _rendered(entries, Format.MARKDOWN) + "\n")


def _exit_code(entries: "list[Entry]") -> int:
    from gsgen.contract.report import Report, exit_code

    reports = [entry for entry in entries if isinstance(entry, Report)]
    code = exit_code(reports)
    unreadable = len(reports) < len(entries)
    return _UNREADABLE if unreadable and code != _INTERNAL else code
