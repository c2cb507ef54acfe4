"""`gsgen validate`: judge models by the contract."""

__all__ = ["validate"]

import sys
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.errors import ConfigInvalid, GsgenError, ModelUnreadable

if TYPE_CHECKING:
    from gsgen.contract.config import Settings
    from gsgen.contract.report import Report
    from gsgen.contract.rule import Registry

_UNREADABLE = 4
_INTERNAL = 3
_DEFAULT_CONFIG = Path("gsgen.toml")


class Format(StrEnum):
    """How a report is printed."""

    TEXT = "text"
    JSON = "json"


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
        bool, typer.Option("-v", "--verbose", help="List every rule.")
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
    entries = [_judge(model, settings, registry) for model in models]
    _print(entries, format, output, verbose)
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


if TYPE_CHECKING:
    from gsgen.contract.finding import Severity

def _judge(model: Path, settings: "Settings", registry: "Registry") -> "Entry":
    from gsgen.contract.engine import validate as judge
    from gsgen.contract.report import Unreadable

    try:
        return judge(model, settings, registry=registry, progress=_progress)
    except ModelUnreadable as error:
        return Unreadable(str(model), error)


def _progress(words: str) -> None:
    """Show what is being done, where someone is watching."""
    if sys.stderr.isatty():
        typer.echo(f"\r\x1b[2K{words} …", err=True, nl=False)


def _print(
    entries: "list[Report | tuple[str, GsgenError]]",
    format: Format,
    output: Path | None,
    verbose: bool,
) -> None:
    from gsgen.contract.commands.output import show, write_text
    from gsgen.contract.reporters import machine, text

    if sys.stderr.isatty():
        typer.echo("\r\x1b[2K", err=True, nl=False)
    for entry in entries:
        if isinstance(entry, tuple):
            typer.echo(f"gsgen: {entry[1]}", err=True)
    if format is Format.JSON:
        made = machine.to_json(entries)
        write_text(output, made + "\n") if output else typer.echo(made)
        return
    lines = [
        line
        for entry in entries
        if not isinstance(entry, tuple)
        for line in text.render(entry, verbose=verbose)
    ]
    if output:
        write_text(output, "".join(line.text + "\n" for line in lines))
    else:
        show(lines)


def _exit_code(entries: "list[Report | tuple[str, GsgenError]]") -> int:
    from gsgen.contract.report import exit_code

    reports = [entry for entry in entries if not isinstance(entry, tuple)]
    code = exit_code(reports)
    unreadable = len(reports) < len(entries)
    return _UNREADABLE if unreadable and code != _INTERNAL else code
